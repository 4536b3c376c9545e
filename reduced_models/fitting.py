"""`fit`: the parameters of a law from a record, through the law's differential equation.

The whole motion is compared, not its derivatives: for trial parameters the equation is solved
from a fitted initial state, and Levenberg-Marquardt changes the parameters until the solution
lies on the record. Many random starts, first on the first two swings and then on all of the
record, keep it from settling in a wrong valley.
"""

from __future__ import annotations

import math
import warnings
from typing import Literal, NamedTuple

import numpy as np

from granular.errors import InputError
from granular.record import PistonRecord
from reduced_models.assessment import Training, model_of
from reduced_models.estimates import Estimates, estimates
from reduced_models.law import Law
from reduced_models.laws import law_named
from reduced_models.model import HeightMap, ReducedModel
from reduced_models.problem import Problem, problem_of
from reduced_models.refinement import Grid, grid_of, problem_equations, solution
from reduced_models.rollout import grid_steps
from reduced_models.search import BLOWN_UP, Prior, means_on_grid, search
from reduced_models.starts import start_vectors

STARTS = 16
HOLDOUT = 0.3
_FIRST_SWINGS = 2.0
_TIE = 1e-7  # residuals below this fraction of the amplitude are not told apart
COARSE_STEPS, FINE_STEPS = 16, 64
"""Grid steps of a period: the phase error of a period is then 4e-6 and 1e-9."""


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
        Fraction of the record, at its end, that is held out: first guesses, the choice of the map
        and a first model do without it, and that model is judged on it. The model that is given
        back is then fitted to all of the record. 0 for none.
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
        If an argument is out of its range, no start led to a solution that stays finite, or the
        solution cannot be followed to the accuracy that the fit needs.

    Warns
    -----
    UserWarning
        For each of the model's notes: where few starts agree, or the law leaves over much more
        than the record's noise.
    """
    chosen = law_named(law) if isinstance(law, str) else law
    if not isinstance(map, HeightMap) and map not in ("auto", "fitted"):
        raise InputError(f"map = {map!r}; give 'auto', 'fitted' or a HeightMap")
    check_options(starts, holdout, confidence)
    data = _split(record, holdout)
    guess = estimates(data.training)
    candidates = [
        _candidate(problem_of(chosen, height_map, guess), data, guess, starts, seed)
        for height_map in _maps(chosen, map)
    ]
    best = min(candidates, key=_information)
    if not math.isfinite(_information(best)):
        raise InputError(
            f"no start led to a solution of {chosen.name!r} that stays finite over the record; try "
            "another law, more starts or a shorter record"
        )
    found = solution(best.grid, best.theta, best.samples)
    training = Training(best.samples, data.stop, starts, best.converged)
    model = model_of(found, training, confidence)
    for note in model.notes:
        warnings.warn(f"fit of {chosen.name}: {note}", stacklevel=2)
    return model


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


class _Data(NamedTuple):
    """A record from time 0 on, and the stretch of it that a fit may see before it is judged."""

    record: PistonRecord
    training: PistonRecord
    stop: float


def _split(record: PistonRecord, holdout: float) -> _Data:
    time = record.time - record.time[0]
    stop = float(time[-1]) * (1.0 - holdout)
    count = int(np.searchsorted(time, stop, side="right"))
    # Two samples make a record; what is too short to fit is told by its estimates.
    count = max(2, count)
    return _Data(
        PistonRecord(time, record.height), PistonRecord(time[:count], record.height[:count]), stop
    )


class _Candidate(NamedTuple):
    """A law with one way to map the height, fitted to the training stretch.

    Attributes
    ----------
    grid : Grid
        Of the whole record.
    theta : float64 (p,)
    samples, converged : int
        Of the training stretch; starts that led to this fit.
    cost : float
        Sum of the squared training residuals; infinite where the solution blows up.
    """

    grid: Grid
    theta: np.ndarray
    samples: int
    converged: int
    cost: float


def _candidate(
    problem: Problem, data: _Data, guess: Estimates, starts: int, seed: int
) -> _Candidate:
    """Search from random starts, then sharpen the best one."""
    steps = grid_steps(float(data.record.time[-1]), guess.period, FINE_STEPS)
    random = np.random.default_rng(seed)
    theta = start_vectors(problem, guess, data.training, starts, random)
    theta, costs = _searched(problem, data.training, guess, theta)
    count = len(data.training)
    tie = count * _TIE**2
    converged = int((costs <= float(costs.min()) * 1.01 + tie).sum())
    grid = grid_of(problem, data.record, steps)
    best = grid.sharpened(theta[int(costs.argmin())], count)
    residuals = grid.residuals(best)[:count]
    finite = bool((np.abs(residuals) < BLOWN_UP).all())
    cost = float(residuals @ residuals) if finite else math.inf
    return _Candidate(grid, best, count, converged, cost)


def _searched(
    problem: Problem, training: PistonRecord, guess: Estimates, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Search vectors and costs of all starts, on the first swings, then on the whole stretch."""
    duration = float(training.time[-1])
    steps = grid_steps(duration, guess.shortest_period, COARSE_STEPS)
    means = means_on_grid(training.time, training.height, steps)
    equations = problem_equations(problem, steps)
    grid = means.step * np.arange(steps + 1)
    costs = np.full(len(theta), math.inf)
    for stop in (_FIRST_SWINGS * guess.period, duration):
        weight = means.weight * (grid <= stop)
        normal = equations.of(means._replace(weight=weight), problem.scales)
        theta, costs = search(normal, theta, Prior(problem.prior, float((weight**2).sum())))
    return theta, costs


def _information(found: _Candidate) -> float:
    """Bayesian information criterion; residuals below the tie level count as equal."""
    mean = max(found.cost / found.samples, _TIE**2)
    return found.samples * math.log(mean) + len(found.theta) * math.log(found.samples)
