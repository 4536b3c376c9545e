"""A reduced model: a law with its parameters, how sure they are, and what they were judged on."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.files import write_json
from reduced_models.laws import LAWS
from reduced_models.laws.law import Law
from reduced_models.laws.printing import latex, rounded

if TYPE_CHECKING:
    import sympy

    from reduced_models.laws.solution import Motion
    from reduced_models.models.response import Cycle, FrequencyResponse

FORMAT = 1
_MARGIN = 0.05  # of the range of heights seen


@dataclasses.dataclass(frozen=True)
class HeightMap:
    """The affine map of the height: height = shift + scale z.

    Attributes
    ----------
    shift, scale : float
        [m]
    fitted : bool
        Whether the map was fitted to the data, or given.
    """

    shift: float = 0.0
    scale: float = 1.0
    fitted: bool = False

    def __str__(self) -> str:
        sign = "-" if self.shift >= 0.0 else "+"
        return f"z = (height {sign} {abs(self.shift):.5g} m)/({self.scale:.5g} m)"

    def to_law(self, height: Any) -> Any:
        """The coordinate z of the law at a height [m]."""
        return (height - self.shift) / self.scale

    def to_height(self, z: Any) -> Any:
        """The height [m] at a coordinate z of the law."""
        return self.shift + self.scale * z


@dataclasses.dataclass(frozen=True)
class Direction:
    """A direction in which the parameters can move without the data noticing.

    Attributes
    ----------
    powers : mapping of str to float
        How the parameters change together: each one as t to this power, for a common t.
    spread : float
        Standard deviation of log t that the data leave. A parameter that may be zero and is small
        against its natural size moves by so many of those sizes instead.
    """

    powers: Mapping[str, float]
    spread: float

    def __str__(self) -> str:
        moving = ", ".join(f"{name} by t^{power:.2g}" for name, power in self.powers.items())
        sure = (
            f"t is known to a factor of {math.exp(self.spread):.2g}"
            if self.spread < 7
            else ("t can be anything")
        )
        return f"the data do not notice when {moving} change together ({sure})"


@dataclasses.dataclass(frozen=True)
class AtRest:
    """What a law says of small motions about its level of rest, with intervals.

    Attributes
    ----------
    height, period, damping_ratio : float
        [m], period of the undamped small swing [s], fraction of critical damping.
    intervals : mapping of str to (float, float)
    """

    height: float
    period: float
    damping_ratio: float
    intervals: Mapping[str, tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Quality:
    """How well a model describes the data.

    Attributes
    ----------
    residual : float
        Root mean square of height minus model over the record [m].
    relative : float
        The same over the rms swing of the record.
    holdout : float or None
        Rms error of the roll-out over the held-out stretch of a model that has not seen it, over
        the rms swing of the whole record; infinite where that model blows up. To be compared with
        ``holdout_at_rest``.
    holdout_from : float or None
        Time since the record's start at which that stretch begins [s].
    starts, converged : int
        Random starts, and how many of them led to the best fit.
    samples : int
    solver_error : float
        Greatest difference of the solution that was fitted and an adaptive one at a tolerance of
        1e-10, over the amplitude.
    holdout_at_rest : float or None
        The same error of a piston that stays at the level of rest of the training stretch: what
        a prediction has to beat.
    noise : float
        Standard deviation of white noise in the record, from its third differences [m].
    correlation : float
        Integrated autocorrelation time of the residuals, in samples.
    """

    residual: float
    relative: float
    holdout: float | None
    holdout_from: float | None
    starts: int
    converged: int
    samples: int
    solver_error: float
    holdout_at_rest: float | None = None
    noise: float = 0.0
    correlation: float = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class ReducedModel:
    """A law with parameters.

    Attributes
    ----------
    law : Law
    parameters : mapping of str to float
        In the units of ``law.units``.
    intervals : mapping of str to (float, float)
        Confidence intervals of the parameters, and of ``shift`` and ``scale`` where fitted.
    confidence : float
        Of the intervals.
    map : HeightMap
    initial : (float, float)
        Height [m] and velocity [m/s] at the record's start.
    at_rest : AtRest or None
        None where the law has no level of rest near the record.
    quality : Quality
    undetermined : tuple of Direction
        Directions that the data leave open.
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] seen.
    notes : tuple of str
        What is to be doubted, in plain words.
    provenance : mapping of str to str
        Which data and which fit the model comes from.
    """

    law: Law
    parameters: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    confidence: float
    map: HeightMap
    initial: tuple[float, float]
    at_rest: AtRest | None
    quality: Quality
    undetermined: tuple[Direction, ...] = ()
    domain: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def equation(self) -> sympy.Eq:
        """The law in z(t), with symbols for the parameters."""
        return self.law.sympy_equation()

    @property
    def fitted_equation(self) -> sympy.Eq:
        """The law in z(t), with the fitted numbers."""
        return self.law.sympy_equation(self.parameters)

    @property
    def latex(self) -> str:
        """The law in LaTeX, with symbols."""
        return latex(self.equation)

    @property
    def fitted_latex(self) -> str:
        """The law in LaTeX, with the fitted numbers to four digits."""
        return latex(self.law.sympy_equation(rounded(self.parameters)))

    def simulate(
        self,
        t: np.ndarray,
        z0: float | None = None,
        v0: float | None = None,
        inputs: Mapping[str, np.ndarray] | None = None,
    ) -> PistonRecord:
        """The motion that the law predicts.

        Parameters
        ----------
        t : float (n,)
            Times [s], increasing; the motion starts at the first.
        z0, v0 : float, optional
            Height [m] and velocity [m/s] at the start; those of the fitted record if not given.
        inputs : mapping of str to float (n,), optional
            The law's inputs at these times.

        Returns
        -------
        PistonRecord
            Height and velocity at ``t``.

        Raises
        ------
        InputError
            If the times do not increase, an input is missing, the solution blows up, or it is too
            stiff to follow.
        """
        from reduced_models.laws.solution import motion

        times = np.asarray(t, dtype=np.float64)
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InputError("t must hold at least two increasing times")
        given = inputs or {}
        for name in self.law.inputs:
            if name not in given or np.shape(given[name]) != times.shape:
                raise InputError(
                    f"the law {self.law.name!r} has the input {name!r}; give inputs={{{name!r}: "
                    "one value a time}"
                )
        start = (
            self.initial[0] if z0 is None else z0,
            self.initial[1] if v0 is None else v0,
        )
        scale = self.map.scale
        size = max(abs(self.map.to_law(start[0])), abs(start[1] / scale), 1e-300)
        if self.at_rest is not None:
            size = max(abs(start[0] - self.at_rest.height) / scale, 1e-6 * size)
        if self.law.inputs and "height" in self.domain:
            # A driven motion may well start at rest.
            size = max(size, (self.domain["height"][1] - self.domain["height"][0]) / abs(scale))
        values = [self.parameters[name] for name in self.law.parameters]
        drive = [np.asarray(given[name], dtype=np.float64) for name in self.law.inputs]
        z_start = self.map.to_law(start[0])
        found = motion(self.law, times, z_start, start[1] / scale, values, size, drive)
        if found.ending != "complete":
            raise InputError(_incomplete(self.law.name, times, found))
        return PistonRecord(times, self.map.to_height(found.z), scale * found.velocity)

    def follow(self, record: PistonRecord) -> PistonRecord:
        """The motion at the times of a record, with its inputs, from the fitted initial state.

        Raises
        ------
        InputError
            As `simulate`; also if the record lacks an input.
        """
        from reduced_models.records.inputs import column

        inputs = {name: column(record, name) for name in self.law.inputs}
        return self.simulate(record.time, inputs=inputs)

    def predict(self, t: np.ndarray) -> np.ndarray:
        """Heights (n,) [m] at increasing times (n,) [s] that start where the record did."""
        return self.simulate(t).height

    def score(self, record: PistonRecord) -> float:
        """Coefficient of determination R^2 of a prediction from the record's first period.

        Raises
        ------
        RecordError
            If the record is too short, does not move, or lacks an input of the law.
        """
        from reduced_models.models.roll_out import roll_out

        return 1.0 - roll_out(self, record).relative ** 2

    def decay(self, amplitude: float, periods: float = 10.0) -> PistonRecord:
        """The motion of a piston let go so far above its level of rest [m]; see `response`."""
        from reduced_models.models.response import decay

        return decay(self, amplitude, periods)

    def cycle(self, amplitude: float, frequency: float | None = None) -> Cycle:
        """Equivalent stiffness and damping, and energy dissipated, in a cycle; see `response`."""
        from reduced_models.models.response import cycle

        return cycle(self, amplitude, frequency)

    def frequency_response(
        self, force: float, frequencies: np.ndarray, largest: float | None = None
    ) -> FrequencyResponse:
        """Steady amplitudes under a harmonic force, by describing functions; see `response`."""
        from reduced_models.models.response import frequency_response

        return frequency_response(self, force, frequencies, largest)

    @property
    def numpy_source(self) -> str:
        """Python source of a stand-alone module of the model, which needs NumPy alone."""
        from reduced_models.models.export import numpy_source

        return numpy_source(self)

    @property
    def text(self) -> str:
        """Equation, parameters, domain, provenance and LaTeX as text."""
        from reduced_models.models.export import equations_text

        return equations_text(self)

    def outside(self, motion: PistonRecord) -> str:
        """Where a motion leaves the heights that the model was fitted to, in words; or nothing."""
        low, high = self.domain.get("height", (-math.inf, math.inf))
        margin = _MARGIN * (high - low)
        least, most = float(motion.height.min()), float(motion.height.max())
        if least >= low - margin and most <= high + margin:
            return ""
        return (
            f"the motion goes from {least:.4g} to {most:.4g} m, and the law {self.law.name!r} was "
            f"fitted to heights from {low:.4g} to {high:.4g} m: read it as an extrapolation"
        )

    def __str__(self) -> str:
        lines = [f"{self.law.name}: {self.law.equation}"]
        if self.law.mapped:
            lines.append(f"  {self.map}" + ("" if self.map.fitted else " (given)"))
        values = dict(self.parameters)
        if self.map.fitted:
            values |= {"shift": self.map.shift, "scale": self.map.scale}
        for name, value in values.items():
            low, high = self.intervals[name]
            unit = self.law.units.get(name, "m" if name in ("shift", "scale") else "")
            lines.append(f"  {name} = {value:.5g} {unit}  [{low:.5g}, {high:.5g}]")
        lines += [f"  open: {direction}" for direction in self.undetermined]
        if self.at_rest is not None:
            lines.append(
                f"  at rest: height {self.at_rest.height:.5g} m, period "
                f"{self.at_rest.period:.5g} s, damping ratio {self.at_rest.damping_ratio:.4g}"
            )
        quality = f"  residual {100.0 * self.quality.relative:.3g} % of the rms swing"
        if self.quality.holdout is not None:
            quality += f", held-out stretch {100.0 * self.quality.holdout:.3g} %"
        if self.quality.holdout_at_rest is not None:
            quality += f" (a piston at rest: {100.0 * self.quality.holdout_at_rest:.3g} %)"
        lines.append(quality)
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def to_plain(self) -> dict[str, Any]:
        """The model as plain data (numbers, texts, lists)."""
        return {
            "format": FORMAT,
            "law": self.law.name,
            "equation": self.law.equation,
            "latex": self.fitted_latex,
            "parameters": dict(self.parameters),
            "units": dict(self.law.units),
            "positive": list(self.law.positive),
            "mapped": self.law.mapped,
            "source": self.law.source,
            "intervals": {name: list(pair) for name, pair in self.intervals.items()},
            "confidence": self.confidence,
            "map": dataclasses.asdict(self.map),
            "initial": list(self.initial),
            "at_rest": None if self.at_rest is None else dataclasses.asdict(self.at_rest),
            "quality": dataclasses.asdict(self.quality),
            "undetermined": [dataclasses.asdict(direction) for direction in self.undetermined],
            "domain": {name: list(pair) for name, pair in self.domain.items()},
            "notes": list(self.notes),
            "inputs": list(self.law.inputs),
            "resolution": self.law.resolution,
            "provenance": dict(self.provenance),
        }

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file, which `load_model` reads back to the same bits."""
        write_json(Path(path), self.to_plain())

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """A model from plain data.

        Raises
        ------
        InputError
            If the data are not those of a model.
        """
        try:
            at_rest = plain["at_rest"]
            return cls(
                law=_law_from_plain(plain),
                parameters=plain["parameters"],
                intervals=_pairs(plain["intervals"]),
                confidence=plain["confidence"],
                map=HeightMap(**plain["map"]),
                initial=(plain["initial"][0], plain["initial"][1]),
                at_rest=None
                if at_rest is None
                else AtRest(**{**at_rest, "intervals": _pairs(at_rest["intervals"])}),
                quality=_quality_from_plain(plain["quality"]),
                undetermined=tuple(Direction(**direction) for direction in plain["undetermined"]),
                domain=_pairs(plain["domain"]),
                notes=tuple(plain["notes"]),
                provenance=dict(plain.get("provenance", {})),
            )
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"the data are not those of a reduced model: {error!r}") from None


def _incomplete(name: str, times: np.ndarray, found: Motion) -> str:
    """Why a solution does not reach the last of the times."""
    from reduced_models.laws.solution import STEP_BUDGETS

    reached = np.flatnonzero(np.isfinite(found.z))
    last = times[reached[-1]] if len(reached) else times[0]
    if found.ending == "blow-up":
        cause = f"blows up behind t = {last:g} s"
    else:
        cause = (
            f"needs more than {STEP_BUDGETS[-1]} steps behind t = {last:g} s (it is stiff there, "
            "or leaves where the law is defined)"
        )
    return (
        f"the solution of the law {name!r} {cause}; start nearer to rest or ask for a shorter time"
    )


def _law_from_plain(plain: Mapping[str, Any]) -> Law:
    """A law of the package, or one of the user's own, from its equation."""
    own = Law(
        name=plain["law"],
        equation=plain["equation"],
        positive=tuple(plain["positive"]),
        units=dict(plain["units"]),
        mapped=bool(plain["mapped"]),
        source=plain["source"],
        inputs=tuple(plain.get("inputs", ())),
        resolution=int(plain.get("resolution", 1)),
    )
    if set(own.parameters) != set(plain["parameters"]):
        raise ValueError("the equation does not have the parameters that are given")
    packaged = LAWS.get(own.name)
    return packaged if packaged is not None and packaged.equation == own.equation else own


def _quality_from_plain(plain: Mapping[str, Any]) -> Quality:
    quality = Quality(**plain)
    if quality.holdout is None and quality.holdout_from is not None:
        return dataclasses.replace(quality, holdout=math.inf)
    return quality


def _pairs(plain: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    def number(value: float | None, instead: float) -> float:
        return instead if value is None else float(value)

    return {
        name: (number(low, -math.inf), number(high, math.inf))
        for name, (low, high) in plain.items()
    }


def load_model(path: str | Path) -> ReducedModel:
    """A model from the JSON file that `ReducedModel.save` wrote.

    Raises
    ------
    InputError
        If there is no such file, or it holds no model.
    """
    try:
        plain = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a model: {error}") from None
    if not isinstance(plain, dict):
        raise InputError(f"{path}: holds no model; give the model.json that was saved")
    return ReducedModel.from_plain(plain)
