"""Check that a user's functions fit each other, in plain Python at a few points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.effects.custom_law import Definition, Grain
from granular.effects.effect import EffectContext
from granular.effects.pair_law import Species
from granular.shared.errors import InputError

# Far above the error of the difference quotient, some 1e-11, and far below that of a wrong factor.
CLOSE = 1e-5
"""Relative difference between a derivative and what a function says."""
# Fourth-order differences at this step err by 1e-16 by truncation and 1e-12 by rounding.
_STEP = 1e-4
# Neither round nor symmetric, lest a wrong function be right by chance; a zero crossing hides an error.
_POINTS, _TIMES = ((0.31, 0.17), (0.52, 0.83), (0.77, 0.44)), (0.0, 0.37, 1.9)
_DISTANCES = (0.83, 1.21, 1.94)


def check_effect_functions(definition: Definition, p: Any, context: EffectContext) -> None:
    """Check an effect's functions against each other at a few points, in plain Python."""
    trial, names = _Trial(definition, p), definition.names
    width = context.cell.width / context.scales.length
    ends = len(context.grains.species)
    mass, moment = context.grains.mass_ratios(), context.grains.moment_ratios()
    grains = [
        Grain(x * width, y * width, float(mass[k % ends]), float(moment[k % ends]))
        for k, (x, y) in enumerate(_POINTS)
    ]
    for grain in grains:
        if "force" in names:
            for time in _TIMES:
                trial.check_force(grain, time)
        if "flow" in names:
            trial.check_flow(grain)


def check_pair_functions(definition: Definition, p: Any, species: Sequence[Species]) -> None:
    """Check that a pair law's functions are numbers, and that a given force is the slope of the energy."""
    trial = _Trial(definition, p)
    for first, second in itertools.combinations_with_replacement(species, 2):
        for r in _DISTANCES:
            trial.call("pair_energy", r, first, second)
            if "pair_force" in definition.names:
                trial.check_slope("pair_force", "pair_energy", r, first, second)
            if "pair_stiffness" in definition.names:
                trial.call("pair_stiffness", r, first, second)
        if "tail" in definition.names:
            trial.call("tail", first, second)
    if "reach" in definition.names:
        trial.call("reach")


def check_wall_functions(definition: Definition, p: Any) -> None:
    """Check that a wall law's force is minus the slope of its energy, at a few distances."""
    for w in _DISTANCES:
        _Trial(definition, p).check_slope("force", "energy", w)


class _Trial(NamedTuple):
    """A user's functions and parameters."""

    definition: Definition
    p: Any

    def call(self, name: str, *arguments: Any, count: int = 1) -> Any:
        """Call one of the functions, which is to return so many numbers."""
        try:
            result = self.definition.functions[name](self.p, *arguments)
            numbers = [float(value) for value in ((result,) if count == 1 else tuple(result))]
        except Exception as error:
            raise self.definition.error(f"{name!r} fails", error) from None
        if len(numbers) != count:
            raise self.refusal(f"{name!r} gives {len(numbers)} numbers, not {count}")
        return numbers[0] if count == 1 else numbers

    def refusal(self, words: str) -> InputError:
        """Make the error of functions that do not fit."""
        return InputError(f"{self.definition.display_name}: {words}")

    def compare(
        self, name: str, result: float, energy: Callable[[float], float], at: float, size: float
    ) -> None:
        """Compare what a function gives with the slope of an energy."""
        slope = _numerical_derivative(energy, at)
        if not (math.isfinite(result) and math.isfinite(slope)):
            return  # a position where it cannot be evaluated says nothing
        if abs(result - slope) > CLOSE * max(abs(slope), abs(result), size):
            raise self.refusal(
                f"{name!r} gives {result:.6g} where its energy asks for {slope:.6g} (natural units); "
                "correct one of them"
            )

    def check_slope(self, force: str, energy: str, distance: float, *others: Any) -> None:
        """Check that a function of a distance is minus the slope of another one."""
        result = self.call(force, distance, *others)
        size = 1e-6 * abs(self.call(energy, distance, *others))
        self.compare(force, result, lambda r: -self.call(energy, r, *others), distance, size)

    def check_force(self, grain: Grain, time: float) -> None:
        """Check that the force is minus the gradient, and the power the rate of change, of the energy."""
        fx, fy = self.call("force", grain, time, count=2)
        size = 1e-6 * abs(self.call("energy", grain, time))
        # One part in 1e3 of the other component counts as size: near a zero of this one, rounding of both
        # remains.
        for axis, component, other in (("x", fx, fy), ("y", fy, fx)):
            self.compare(
                "force",
                component,
                lambda position, axis=axis: -self.call("energy", grain._replace(**{axis: position}), time),  # type: ignore[misc]
                getattr(grain, axis),
                size + 1e-3 * abs(other),
            )
        power = self.call("power", grain, time) if "power" in self.definition.names else 0.0
        self.compare("power", power, lambda moment: self.call("energy", grain, moment), time, size)
        if "stiffness" in self.definition.names:
            self.call("stiffness", grain, time)

    def check_flow(self, grain: Grain) -> None:
        """Check that the flow takes energy, and is exact."""
        for vx, vy, dt in ((0.3, -0.2, 0.1), (0.0, 0.5, 0.02)):
            wx, wy = self.call("flow", grain, vx, vy, dt, count=2)
            # 1e-12: what rounding may add to a flow that takes nothing, a rotation for example.
            if wx * wx + wy * wy > (vx * vx + vy * vy) * (1.0 + 1e-12):
                raise self.refusal("'flow' makes a grain faster; it may only take energy")
            # Half a step before and half behind the drift must be a whole one, or the splitting loses its
            # order.
            twice = self.call("flow", grain, wx, wy, dt, count=2)
            total = self.call("flow", grain, vx, vy, 2.0 * dt, count=2)
            if not np.allclose(twice, total, rtol=1e-9, atol=1e-14):
                raise self.refusal(
                    "'flow' over two spans is not that over both together; solve it exactly, as "
                    "v*exp(-rate*dt)"
                )


def _numerical_derivative(function: Callable[[float], float], at: float) -> float:
    """Return the derivative, to the fourth order in the step."""
    h = _STEP * max(1.0, abs(at))
    near = function(at + h) - function(at - h)
    far = function(at + 2.0 * h) - function(at - 2.0 * h)
    return (8.0 * near - far) / (12.0 * h)
