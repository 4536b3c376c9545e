"""A law with numbers for its parameters, and the motions that it predicts."""

from __future__ import annotations

import dataclasses
import decimal
import functools
import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.laws.printing import latex, rounded, rounded_equation, rounded_expression
from reduced_models.laws.small_swing import NoSwing, small_swing, swing_of_equation
from reduced_models.records.inputs import TIME, Interpolation, column

if TYPE_CHECKING:
    import sympy

    from reduced_models.laws.solution import Solution

_METRE = re.compile(r"\bm\b")
FEWEST_DIGITS, MOST_DIGITS = 4, 15
"""Of printed numbers; a double holds 15."""
_FLOORS = {"height": 1e-9, "period": 1e-9, "damping_ratio": 1e-6}
"""What no interval has to be narrower than: that of a noiseless record, or of what a law fixes."""


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

    def __str__(self) -> str:
        units = {"height": " m", "period": " s", "damping_ratio": ""}
        lines = []
        for name, unit in units.items():
            value, interval = getattr(self, name), self.intervals.get(name)
            text = (
                f"{value:.4g}{unit}" if interval is None else _with_interval(value, unit, interval)
            )
            lines.append(f"{name.replace('_', ' ')}: {text}")
        return "\n".join(lines)


def _with_interval(value: float, unit: str, interval: tuple[float, float]) -> str:
    """To the decimal that the interval's width tells; its ends are rounded outwards."""
    low, high = interval
    if not 0.0 < high - low < math.inf:
        return f"{value:.4g}{unit}  [{low:.4g}, {high:.4g}]"
    decimals = min(MOST_DIGITS, max(0, 1 - math.floor(math.log10(high - low))))
    below, above = (
        decimal.Decimal(repr(float(one))).quantize(
            decimal.Decimal(1).scaleb(-decimals), rounding=how
        )
        for one, how in ((low, decimal.ROUND_FLOOR), (high, decimal.ROUND_CEILING))
    )
    return f"{value:.{decimals}f}{unit}  [{below:f}, {above:f}]"


class FittedLaw:
    """A law with numbers, as a `ReducedModel` has it; the attributes are those of the model.

    Attributes
    ----------
    law : Law
    parameters : mapping of str to float
        In the units of ``law.units``.
    map : HeightMap
    initial : (float, float)
        Height [m] and velocity [m/s] at the record's start.
    at_rest : AtRest or None
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] seen.
    provenance : mapping of str to str
    hidden : mapping of str to float
        Hidden states at the record's start, where they are not zero.
    input_interpolation : str
        What an input does between samples.
    angle : bool
        Whether the height is an angle: [rad] stands for [m] then.
    """

    law: Law
    parameters: Mapping[str, float]
    map: HeightMap
    initial: tuple[float, float]
    at_rest: AtRest | None
    domain: Mapping[str, tuple[float, float]]
    provenance: Mapping[str, str]
    hidden: Mapping[str, float]
    input_interpolation: Interpolation
    angle: bool

    @property
    def unit(self) -> str:
        """Of the coordinate."""
        return "rad" if self.angle else "m"

    @property
    def coordinate(self) -> str:
        """What the coordinate is called."""
        return "angle" if self.angle else "height"

    def unit_of(self, name: str) -> str:
        """Of a parameter, of ``shift`` or of ``scale``."""
        found = self.law.units.get(name, "m" if name in ("shift", "scale") else "")
        return _METRE.sub("rad", found) if self.angle else found

    def map_text(self, digits: int) -> str:
        """How z follows from the coordinate."""
        return self.map.text(digits, self.coordinate, self.unit)

    @property
    def literature(self) -> tuple[str, ...]:
        """Texts that name the papers behind its law; see `granular.cite`."""
        return self.law.literature

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
        """The law in LaTeX, with the fitted numbers to `printed_digits`."""
        return latex(self.printed_equation)

    @functools.cached_property
    def printed_digits(self) -> int:
        """Digits with which the equation says where the piston rests and how it swings there.

        The fewest from four on with which level, period and damping ratio of the printed equation,
        and of the printed parameters, lie within their intervals.
        """
        if self.at_rest is None:
            return FEWEST_DIGITS
        enough = (digits for digits in range(FEWEST_DIGITS, MOST_DIGITS) if self._tells(digits))
        return next(enough, MOST_DIGITS)

    def _tells(self, digits: int) -> bool:
        """Whether so many digits say where the piston rests and how it swings there."""
        assert self.at_rest is not None
        z = self.map.to_law(self.at_rest.height)
        values = [rounded(self.parameters[name], digits) for name in self.law.parameters]
        shift, scale = (rounded(each, max(digits, 5)) for each in (self.map.shift, self.map.scale))
        swings = [small_swing(self.law, values, z)]
        if not self.law.hidden:  # whose equations stand beside this one
            swings.append(swing_of_equation(rounded_equation(self.fitted_equation, digits), z))
        for swing in swings:
            if isinstance(swing, NoSwing):
                return False
            printed = (shift + scale * swing.z, swing.period, swing.damping_ratio)
            for (name, floor), figure in zip(_FLOORS.items(), printed, strict=True):
                low, high = self.at_rest.intervals[name]
                slack = floor * abs(getattr(self.at_rest, name))
                if not low - slack <= figure <= high + slack:
                    return False
        return True

    @property
    def printed_equation(self) -> sympy.Eq:
        """The law in z(t), with the fitted numbers to `printed_digits`."""
        return rounded_equation(self.fitted_equation, self.printed_digits)

    @property
    def printed_hidden(self) -> dict[str, sympy.Expr]:
        """The rate of each hidden state in z(t), with the fitted numbers to `printed_digits`."""
        rates = self.law.sympy_hidden(self.parameters)
        return {name: rounded_expression(one, self.printed_digits) for name, one in rates.items()}

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
            The law's inputs at these times; a law that names ``t`` counts it from the first.

        Returns
        -------
        PistonRecord
            Height and velocity at ``t``.

        Raises
        ------
        InputError
            If the times do not increase, an input is missing, the solution diverges, or it is too
            stiff to follow.
        """
        from reduced_models.laws.solution import solution

        times = np.asarray(t, dtype=np.float64)
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InputError("t must hold at least two increasing times")
        given = {TIME: times - times[0]} | dict(inputs or {})
        for name in self.law.inputs:
            if name not in given or np.shape(given[name]) != times.shape:
                raise InputError(
                    f"the law {quoted(self.law.name)} has the input {quoted(name)}; give "
                    f"inputs={{{quoted(name)}: "
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
        # Another start forgets the record's history.
        same = z0 is None and v0 is None
        hidden = [self.hidden.get(name, 0.0) if same else 0.0 for name in self.law.hidden]
        found = solution(
            self.law, times, z_start, start[1] / scale, values, size, drive, hidden,
            self.input_interpolation,
        )  # fmt: skip
        if found.ending != "complete":
            raise InputError(_incomplete(self.law.name, times, found))
        height, velocity = self.map.to_height(found.z), scale * found.velocity
        return PistonRecord(times, height, velocity, angle=self.angle)

    def follow(self, record: PistonRecord) -> PistonRecord:
        """The motion at the times of a record, with its inputs, from the fitted initial state.

        Raises
        ------
        InputError
            As `simulate`; also if the record lacks an input.
        """
        inputs = {name: column(record, name) for name in self.law.inputs}
        return self.simulate(record.time, inputs=inputs)

    def predict(self, t: np.ndarray) -> np.ndarray:
        """Heights (n,) [m] at increasing times (n,) [s] that start where the record did."""
        return self.simulate(t).height


def _incomplete(name: str, times: np.ndarray, found: Solution) -> str:
    """Why a solution does not reach the last of the times."""
    from reduced_models.laws.solution import STEP_BUDGETS

    reached = np.flatnonzero(np.isfinite(found.z))
    last = times[reached[-1]] if len(reached) else times[0]
    if found.ending == "blow-up":
        cause = f"diverges behind t = {last:g} s"
    else:
        cause = (
            f"needs more than {STEP_BUDGETS[-1]} steps behind t = {last:g} s (it is stiff there, "
            "or leaves where the law is defined)"
        )
    return (
        f"the solution of the law {quoted(name)} {cause}; start nearer to rest or ask for a "
        "shorter time"
    )
