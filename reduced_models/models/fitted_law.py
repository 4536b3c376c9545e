"""A law with values of its parameters, and the motions that it predicts."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from granular.records.headings import COORDINATES, CoordinateUnit
from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote
from reduced_models.laws.law import HeightLine, Law
from reduced_models.laws.linearization import (
    NoOscillationReason,
    make_acceleration_of_equation,
    make_rates_of_law,
    small_oscillation,
    small_oscillation_of_equation,
    solve_harmonic_balance,
)
from reduced_models.laws.printing import (
    equation_as_latex,
    round_equation,
    round_expression,
    round_significant,
)
from reduced_models.models.at_rest import AtRest, HarmonicCycle
from reduced_models.models.plain_data import Interval, Lines, Size
from reduced_models.records.inputs import TIME, Interpolation, input_column
from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    import sympy

    from reduced_models.laws.solution import Solution

_METRE = re.compile(r"\bm\b")
FEWEST_DIGITS, MOST_DIGITS = 4, 9
"""Minimum and maximum number of significant digits of printed numbers; the maximum applies to records
without noise."""
_FLOORS = {"height": 1e-9, "period": 1e-9, "damping_ratio": 1e-6}
"""Relative tolerance by which intervals are widened when the number of printed digits is chosen, because
records without noise have very narrow intervals."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class FittedLaw:
    """A law with values of its parameters: the part of a `ReducedModel` that predicts motions.

    Attributes
    ----------
    law : Law
        Law of motion, or of the force on a stroke.
    parameters : mapping of str to float
        In the units of ``law.units``.
    initial : (float, float)
        Height [m] and velocity [m/s] at the record's start.
    at_rest : AtRest or None
        Small oscillations about equilibrium; None if the law has no equilibrium near the record.
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] in the fitted records.
    provenance : mapping of str to str
        Data and fit from which the model was made.
    hidden : mapping of str to float
        Nonzero hidden states at the record's start.
    input_interpolation : str
        Interpolation of the inputs between samples.
    coordinate_unit : "m" or "rad"
        Unit of the height; for an angle, [m] means [rad].
    """

    law: Law
    parameters: Mapping[str, float]
    initial: tuple[float, float]
    at_rest: AtRest | None
    intervals: Mapping[str, Interval] = dataclasses.field(default_factory=dict)
    domain: Mapping[str, Interval] = dataclasses.field(default_factory=dict)
    provenance: Mapping[str, Lines] = dataclasses.field(default_factory=dict)
    hidden: Mapping[str, float] = dataclasses.field(default_factory=dict)
    input_interpolation: Interpolation = "spline"
    coordinate_unit: CoordinateUnit = "m"
    conventions: Mapping[str, float] = dataclasses.field(default_factory=dict)
    sensor: Sensor | None = None
    observation: str = ""
    cycles: tuple[HarmonicCycle, ...] = ()
    covariance_names: tuple[str, ...] = ()
    covariance: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    quantile: Size = 1.96

    @property
    def all_parameters(self) -> dict[str, float]:
        """Values of all parameters; parameters that are not identified have conventional values."""
        known = {**self.conventions, **self.parameters}
        return {name: known[name] for name in self.law.parameters}

    @property
    def coordinate(self) -> str:
        """Name of the coordinate."""
        return COORDINATES[self.coordinate_unit]

    def unit_of_parameter(self, name: str) -> str:
        """Return the unit of a parameter."""
        return _METRE.sub(self.coordinate_unit, self.law.units.get(name, ""))

    @property
    def height_line(self) -> HeightLine:
        """Linear map from the coordinate of the law's text to the height."""
        return self.law.height_line(self.all_parameters)

    @property
    def literature(self) -> tuple[str, ...]:
        """References of the law as texts; see `granular.cite`."""
        return self.law.literature

    @property
    def equation(self) -> sympy.Eq:
        """The law in z(t), with symbols for the parameters."""
        return self.law.sympy_equation()

    @property
    def fitted_equation(self) -> sympy.Eq:
        """The law in z(t), with the fitted numbers."""
        return self.law.sympy_equation(self.all_parameters)

    @property
    def latex(self) -> str:
        """The law in LaTeX, with symbols."""
        return equation_as_latex(self.equation)

    @property
    def fitted_latex(self) -> str:
        """The law in LaTeX, with the fitted numbers rounded to `printed_digits`."""
        return equation_as_latex(self.printed_equation)

    @functools.cached_property
    def printed_digits(self) -> int:
        """Number of significant digits that preserves equilibrium, period and damping ratio."""
        # The smallest number of digits for which equilibrium, period and damping ratio of the printed
        # equation, and its parameters, are within their intervals.
        if self.at_rest is None:
            return FEWEST_DIGITS
        enough = (digits for digits in range(FEWEST_DIGITS, MOST_DIGITS) if self._digits_suffice(digits))
        return next(enough, MOST_DIGITS)

    def _digits_suffice(self, digits: int) -> bool:
        """Return whether rounding to ``digits`` leaves the small oscillation within the intervals."""
        assert self.at_rest is not None
        rest, law = self.at_rest, self.law
        reach = float(np.ptp(self.domain.get("height", (0.0,))))
        values = [round_significant(value, digits) for value in self.all_parameters.values()]
        line = law.height_line(dict(zip(law.parameters, values, strict=True)))
        swings = [(small_oscillation(law, values, rest.height), make_rates_of_law(law, values), HeightLine())]
        if not law.hidden:  # rates of hidden states are printed as separate equations
            equation = round_equation(self.fitted_equation, digits)
            seen = small_oscillation_of_equation(equation, line.coordinate(rest.height))
            swings.append((seen, make_acceleration_of_equation(equation), line))
        for swing, rates, (shift, scale) in swings:
            if isinstance(swing, NoOscillationReason):
                return False
            ratio = swing.damping_ratio
            if rest.equivalent is not None:
                size, omega = rest.equivalent.amplitude / abs(scale), 2.0 * math.pi / swing.period
                result = solve_harmonic_balance(rates, len(law.hidden), size, swing.z, omega)
                ratio = float(result.damping_ratio[0])
            printed = (shift + scale * swing.z, swing.period, ratio)
            for (name, floor), figure in zip(_FLOORS.items(), printed, strict=True):
                low, high = rest.intervals[name]
                slack = floor * max(abs(getattr(rest, name)), reach if name == "height" else 0.0)
                if not low - slack <= figure <= high + slack:
                    return False
        return True

    @property
    def printed_equation(self) -> sympy.Eq:
        """The law in z(t), with the fitted numbers rounded to `printed_digits`."""
        return round_equation(self.fitted_equation, self.printed_digits)

    @property
    def printed_height(self) -> sympy.Eq:
        """The height as a linear function of z, with the fitted numbers rounded to `printed_digits`."""
        import sympy

        line = (round_significant(value, max(5, self.printed_digits)) for value in self.height_line)
        shift, scale = map(sympy.Float, line)
        return sympy.Eq(sympy.Symbol(self.coordinate), shift + scale * sympy.Symbol("z"), evaluate=False)

    @property
    def printed_hidden_rates(self) -> dict[str, sympy.Expr]:
        """The rate of each hidden state in z(t), with the fitted numbers rounded to `printed_digits`."""
        rates = self.law.sympy_hidden(self.all_parameters)
        return {name: round_expression(rate, self.printed_digits) for name, rate in rates.items()}

    def simulate(
        self,
        t: Float[np.ndarray, "n"],
        z0: float | None = None,
        v0: float | None = None,
        inputs: Mapping[str, np.ndarray] | None = None,
    ) -> PistonRecord:
        """Return the motion at times t [s] from z0 [m] and v0 [m/s], by default the fitted initial state."""
        from reduced_models.laws.solution import observed_signal, solve_law

        if self.law.prescribed:
            raise InputError(
                f"the law {quote(self.law.name)} is for a prescribed motion and cannot predict a motion; "
                f"compute the {self.observation} along a stroke with .simulate_signal(record)"
            )
        times = np.asarray(t, dtype=np.float64)
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InputError("t needs two or more increasing times")
        given = {TIME: times - times[0]} | dict(inputs or {})
        for name in self.law.inputs:
            if name not in given or np.shape(given[name]) != times.shape:
                raise InputError(
                    f"the law {quote(self.law.name)} has the input {quote(name)}; give "
                    f"inputs={{{quote(name)}: "
                    "one value for each time}"
                )
        start = (self.initial[0] if z0 is None else z0, self.initial[1] if v0 is None else v0)
        size = max(abs(start[0]), abs(start[1]), 1e-300)
        if self.at_rest is not None:
            size = max(abs(start[0] - self.at_rest.height), 1e-6 * size)
        if self.law.inputs and "height" in self.domain:
            # A driven motion may start at rest.
            size = max(size, self.domain["height"][1] - self.domain["height"][0])
        values = list(self.all_parameters.values())
        drive = [np.asarray(given[name], dtype=np.float64) for name in self.law.inputs]
        # With another initial state the hidden states of the record do not apply.
        same = z0 is None and v0 is None
        others = {} if same else self._further_coordinates_at_rest(values)
        hidden = [self.hidden.get(name, 0.0) if same else others.get(name, 0.0) for name in self.law.hidden]
        result = solve_law(self.law, times, *start, values, size, drive, hidden, self.input_interpolation)
        if result.ending != "complete":
            raise InputError(_incomplete_solution_text(self.law.name, times, result))
        if "height" in self.law.observations and not self.law.observes_height:
            height = observed_signal(self.law, "height", result, values, drive)
            return PistonRecord(times, height, coordinate_unit=self.coordinate_unit)
        return PistonRecord(times, result.z, result.velocity, coordinate_unit=self.coordinate_unit)

    def _further_coordinates_at_rest(self, values: list[float]) -> dict[str, float]:
        """Return equilibrium values of all coordinates but the first, from which a new motion starts."""
        if self.at_rest is None or not self.law.other_coordinates:
            return {}
        swing = small_oscillation(self.law, values, self.at_rest.height)
        known = (
            () if isinstance(swing, NoOscillationReason) else zip(self.law.hidden, swing.hidden, strict=True)
        )
        return {name: value for name, value in known if name in self.law.other_coordinates}

    def simulate_record(self, record: PistonRecord) -> PistonRecord:
        """Return the motion from the fitted initial state, with the times and inputs of a record."""
        inputs = {name: input_column(record, name) for name in self.law.inputs}
        return self.simulate(record.time, inputs=inputs)

    def predict(self, t: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the heights [m, rad] at times t [s] of the motion from the fitted initial state."""
        return self.simulate(t).height


def _incomplete_solution_text(name: str, times: np.ndarray, result: Solution) -> str:
    """Return the reason why a solution does not reach the last time."""
    from reduced_models.laws.solution import MAXIMUM_STEPS

    reached = np.flatnonzero(np.isfinite(result.z))
    last = times[reached[-1]] if len(reached) else times[0]
    if result.ending == "blow-up":
        cause = f"diverges after t = {last:g} s"
    else:
        cause = (
            f"needs too many steps after t = {last:g} s, where the law jumps or is not defined: more than "
            f"{MAXIMUM_STEPS} for each requested time and each time constant of the law"
        )
    return f"the solution of the law {quote(name)} {cause}; start closer to equilibrium or shorten the time"
