"""`fit`: the parameters of a law from a record, through the law's differential equation.

The whole motion is compared, not its derivatives: for trial parameters the equation is solved
from a fitted initial state, and Levenberg-Marquardt changes the parameters until the solution
lies on the record. Many random starts, first on the first two swings and then on all of the
record, keep it from settling in a wrong valley.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from granular.errors import InputError
from granular.record import PistonRecord
from reduced_models.estimates import Estimates, estimates
from reduced_models.jax_setup import jax
from reduced_models.law import Law
from reduced_models.laws import law_named
from reduced_models.model import HeightMap, Quality, ReducedModel
from reduced_models.rollout import grid_steps, motion
from reduced_models.search import (
    BLOWN_UP,
    Equations,
    Samples,
    equations,
    means_on_grid,
    samples_on_grid,
    search,
)
from reduced_models.uncertainty import interval_analysis

jnp = jax.numpy

STARTS = 16
HOLDOUT = 0.3
_MOST_TRIALS = 60
_PRIOR_SPREAD = 3.0  # of the logarithms, in the pull that keeps flat directions in place
_FIRST_SWINGS = 2.0
_TIE = 1e-7  # residuals below this fraction of the amplitude are not told apart
COARSE_STEPS, FINE_STEPS = 16, 64
"""Grid steps of a period: the phase error of a period is then 4e-6 and 1e-9."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """A law, a way to map the height, and the scales in which the search works.

    The search vector holds the parameters (logarithms of the positive ones, multiples of a unit
    of the others), then, where the map is fitted, its shift (from the rest level) and the logarithm
    of its scale, then height (from the rest level) and velocity at the start. Heights count in
    amplitudes, velocities in amplitudes times the frequency.
    """

    law: Law
    map: HeightMap | None
    units: tuple[float, ...]
    rest: float
    amplitude: float
    speed: float

    @property
    def scales(self) -> np.ndarray:
        """Numbers that the compiled residual takes: rest, amplitude, speed, map, units."""
        given = self.map or HeightMap()
        return np.array(
            [self.rest, self.amplitude, self.speed, given.shift, given.scale, *self.units]
        )

    def physical(self, theta: np.ndarray) -> Any:
        """Parameters, shift and scale of the map, z and its velocity at the start."""
        _, logs, fits_map = self.key
        return physical(theta, self.scales, logs, fits_map, np)

    @property
    def key(self) -> tuple[str, tuple[bool, ...], bool]:
        """What the compiled code depends on."""
        logs = tuple(name in self.law.positive for name in self.law.parameters)
        return self.law.equation, logs, self.map is None


def fit(
    record: PistonRecord,
    law: str | Law = "van-der-pol-like",
    *,
    map: HeightMap | Literal["auto", "fitted"] = "auto",  # noqa: A002
    starts: int = STARTS,
    holdout: float = HOLDOUT,
    confidence: float = 0.95,
    seed: int = 0,
) -> ReducedModel:
    """Fit a law to a record.

    Parameters
    ----------
    record : PistonRecord
    law : str or Law
        A law of the package by its name, or one of your own.
    map : HeightMap, "auto" or "fitted"
        How the height enters a law that has a map (``law.mapped``): as given, fitted, or fitted
        unless the record is described as well with z = height (Bayesian information criterion).
    starts : int
        Random starts.
    holdout : float
        Fraction of the record, at its end, that a second model does not see and is judged on; 0
        for none.
    confidence : float
        Of the intervals.
    seed : int
        Of the random starts.

    Returns
    -------
    ReducedModel

    Raises
    ------
    RecordError
        If the record is too short or does not move.
    InputError
        If an argument is out of its range, or no start led to a solution that stays finite.
    """
    chosen = law_named(law) if isinstance(law, str) else law
    if not isinstance(map, HeightMap) and map not in ("auto", "fitted"):
        raise InputError(f"map = {map!r}; give 'auto', 'fitted' or a HeightMap")
    check_options(starts, holdout, confidence)
    guess = estimates(record)
    candidates = _maps(chosen, map)
    fits = [_Fit(record, chosen, one, guess, holdout, seed).search(starts) for one in candidates]
    best = min(fits, key=lambda one: one.information())
    if not math.isfinite(best.information()):
        raise InputError(
            f"no start led to a solution of {chosen.name!r} that stays finite over the record; try "
            "another law, more starts or a shorter record"
        )
    return best.model(confidence)


def check_options(starts: int = STARTS, holdout: float = HOLDOUT, confidence: float = 0.95) -> None:
    """Raise `InputError` unless the options of `fit` are in their ranges."""
    if not isinstance(starts, int) or starts < 1:
        raise InputError(f"starts = {starts!r}; give a whole number from 1 on")
    if not 0.0 <= holdout <= 0.9:
        raise InputError(f"holdout = {holdout!r}; give a fraction from 0 to 0.9")
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence = {confidence!r}; give a fraction between 0 and 1")


def _maps(law: Law, wanted: HeightMap | str) -> list[HeightMap | None]:
    if not law.mapped or isinstance(wanted, HeightMap):
        return [wanted if isinstance(wanted, HeightMap) and law.mapped else HeightMap()]
    return [None] if wanted == "fitted" else [HeightMap(), None]


@functools.cache
def partial_physical(logs: tuple[bool, ...], fits_map: bool) -> Callable[..., Any]:
    """`physical` for JAX, the same function for the same problem."""
    return lambda theta, scales: physical(theta, scales, logs, fits_map, jnp)


def physical(theta: Any, scales: Any, logs: tuple[bool, ...], fits_map: bool, np_: Any) -> Any:
    """Parameters, shift and scale of the map, and z and its velocity at the start."""
    rest, amplitude, speed, shift, scale = (scales[k] for k in range(5))
    count = len(logs)
    values = tuple(
        np_.exp(theta[k]) if log else scales[5 + k] * theta[k] for k, log in enumerate(logs)
    )
    if fits_map:
        shift = rest + amplitude * theta[count]
        scale = amplitude * np_.exp(theta[count + 1])
    z0 = (rest + amplitude * theta[-2] - shift) / scale
    v0 = speed * theta[-1] / scale
    return values, shift, scale, z0, v0


class _Fit:
    """One fit: a law with one way to map the height."""

    def __init__(
        self,
        record: PistonRecord,
        law: Law,
        map_: HeightMap | None,
        guess: Estimates,
        holdout: float,
        seed: int,
    ) -> None:
        self.record, self.law, self.guess, self.holdout = record, law, guess, holdout
        self.random = np.random.default_rng(seed)
        self.time = record.time - record.time[0]
        speed = guess.amplitude * guess.frequency
        law_guess = guess if map_ is None else guess.seen_as(map_.shift, map_.scale)
        typical = law.start(law_guess, np.random.default_rng(0), 1)
        units = tuple(
            max(abs(float(typical[name][0])), 1e-12) if name not in law.positive else 1.0
            for name in law.parameters
        )
        self.problem = Problem(law, map_, units, guess.rest, guess.amplitude, speed)
        self.theta = np.empty(0)
        self.trained = np.empty(0)
        self.fine: Equations
        self.samples: Samples
        self.cost = math.inf
        self.converged = 0
        self.starts = 0

    # Data --------------------------------------------------------------------------------------

    @property
    def train_end(self) -> float:
        return float(self.time[-1]) * (1.0 - self.holdout)

    # Search ------------------------------------------------------------------------------------

    def _start_vectors(self, count: int) -> np.ndarray:
        law, guess, problem = self.law, self.guess, self.problem
        columns: list[np.ndarray] = []
        shift, log_scale = np.zeros(count), np.zeros(count)
        if problem.map is None:
            log_scale = self.random.uniform(-1.5, 1.5, count)
            level = np.where(
                self.random.random(count) < 0.5,
                self.random.uniform(-2.0, -0.1, count),
                self.random.uniform(2.1, 4.0, count),
            )
            shift = -np.exp(log_scale) * level
        samples: dict[str, list[float]] = {name: [] for name in law.parameters}
        for k in range(count):
            seen = guess.seen_as(
                *(
                    (problem.map.shift, problem.map.scale)
                    if problem.map is not None
                    else (
                        guess.rest + guess.amplitude * shift[k],
                        guess.amplitude * math.exp(log_scale[k]),
                    )
                )
            )
            one = law.start(seen, self.random, 1)
            for name in law.parameters:
                samples[name].append(float(one[name][0]))
        for name, unit in zip(law.parameters, problem.units, strict=True):
            values = np.array(samples[name])
            columns.append(np.log(values) if name in law.positive else values / unit)
        if problem.map is None:
            columns += [shift, log_scale]
        columns.append(np.full(count, (guess.height - guess.rest) / guess.amplitude))
        columns.append(np.full(count, guess.velocity / problem.speed))
        return np.stack(columns, axis=1)

    def _equations(self, steps: int) -> Equations:
        equation, logs, fits_map = self.problem.key
        return equations(equation, partial_physical(logs, fits_map), steps)

    def search(self, starts: int) -> _Fit:
        """Search from random starts, then sharpen the best one."""
        self.starts = starts
        steps = grid_steps(self.time[-1], self.guess.period, COARSE_STEPS)
        means = means_on_grid(self.time, self.record.height, steps)
        coarse, scales = self._equations(steps), self.problem.scales
        theta = self._start_vectors(starts)
        grid = means.step * np.arange(steps + 1)
        for stop in (_FIRST_SWINGS * self.guess.period, self.train_end):
            weight = means.weight * (grid <= min(stop, self.train_end))
            theta, costs = search(
                coarse.of(means._replace(weight=weight), scales),
                theta,
                self._pull(),
                float((weight**2).sum()),
                _MOST_TRIALS,
            )
        tie = len(self.time) * _TIE**2
        self.converged = int((costs <= float(costs.min()) * 1.01 + tie).sum())
        self._prepare_fine()
        self.trained = self._sharpened(theta[int(costs.argmin())], self.train_end)
        self.theta = self.trained
        if self.holdout > 0.0:
            self.theta = self._sharpened(self.trained, math.inf)
        miss = self.misses(self.theta)
        self.cost = float((miss**2).sum())
        if not np.isfinite(self.cost) or (np.abs(miss) >= BLOWN_UP).any():
            self.cost = math.inf
        return self

    def _prepare_fine(self) -> None:
        steps = grid_steps(self.time[-1], self.guess.period, FINE_STEPS)
        self.fine = self._equations(steps)
        self.samples = samples_on_grid(self.time, self.record.height, steps)

    def misses(self, theta: np.ndarray) -> np.ndarray:
        """Residuals of all samples, in amplitudes."""
        found = self.fine.residual(theta, self.samples, self.problem.scales)
        return np.asarray(found)[: len(self.time)]

    def normal_matrix(self, theta: np.ndarray) -> np.ndarray:
        """J'J of all samples, at a search vector."""
        return np.asarray(self.fine.normal(theta[None], self.samples, self.problem.scales)[2])[0]

    def _sharpened(self, start: np.ndarray, stop: float) -> np.ndarray:
        weight = np.zeros_like(self.samples.weight)
        weight[: len(self.time)] = self.time <= stop
        theta, _ = search(
            self.fine.of(self.samples._replace(weight=weight), self.problem.scales),
            start[None],
            self._pull(),
            float(weight.sum()),
            _MOST_TRIALS,
            tolerance=1e-11,
        )
        return np.asarray(theta[0])

    def _pull(self) -> np.ndarray:
        """A pull of parameters and map towards the start that weighs less than one sample."""
        free = len(self.law.parameters) + (2 if self.problem.map is None else 0)
        return np.array([_PRIOR_SPREAD**-2] * free + [0.0, 0.0])

    def information(self) -> float:
        """Bayesian information criterion; residuals below the tie level count as equal."""
        samples = len(self.time)
        mean = max(self.cost / samples, _TIE**2)
        return samples * math.log(mean) + len(self.theta) * math.log(samples)

    # Result ------------------------------------------------------------------------------------

    def _holdout_error(self) -> float | None:
        held = self.time > self.train_end
        if self.holdout == 0.0 or held.sum() < 2:
            return None
        miss = self.misses(self.trained)[held] * self.problem.amplitude
        swing = self.record.height - self.guess.rest
        return float(np.sqrt((miss**2).mean() / (swing**2).mean()))

    def _solver_error(self, map_: HeightMap, values: Any, z0: float, v0: float) -> float:
        """Greatest difference of the grid's solution and diffrax's, in amplitudes."""
        size = self.problem.amplitude / map_.scale
        z, _ = motion(self.law, self.time, z0, v0, values, size)
        seen = self.record.height + self.misses(self.theta) * self.problem.amplitude
        return float(np.abs(map_.to_height(z) - seen).max()) / self.problem.amplitude

    def model(self, confidence: float) -> ReducedModel:
        """The reduced model, with intervals and quality."""
        law, problem = self.law, self.problem
        miss = self.misses(self.theta)
        values, shift, scale, z0, v0 = problem.physical(self.theta)
        height_map = HeightMap(float(shift), float(scale), fitted=problem.map is None)
        analysis = interval_analysis(
            problem, self.theta, self.normal_matrix(self.theta), miss, confidence
        )
        swing = self.record.height - self.guess.rest
        residual = float(np.sqrt((miss**2).mean())) * problem.amplitude
        quality = Quality(
            residual=residual,
            relative=residual / float(np.sqrt((swing**2).mean())),
            holdout=self._holdout_error(),
            holdout_from=self.train_end if self.holdout > 0.0 else None,
            starts=self.starts,
            converged=self.converged,
            samples=len(self.time),
            solver_error=self._solver_error(height_map, values, float(z0), float(v0)),
        )
        speeds = np.gradient(self.record.height, self.time)
        return ReducedModel(
            law=law,
            parameters={name: float(one) for name, one in zip(law.parameters, values, strict=True)},
            intervals=analysis.intervals,
            confidence=confidence,
            map=height_map,
            initial=(float(height_map.to_height(z0)), float(v0 * scale)),
            at_rest=analysis.at_rest,
            quality=quality,
            undetermined=analysis.undetermined,
            domain={
                "height": (float(self.record.height.min()), float(self.record.height.max())),
                "velocity": (float(speeds.min()), float(speeds.max())),
            },
        )
