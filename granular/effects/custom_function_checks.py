"""Check that a user's functions fit each other, in plain Python at a few points."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from granular.effects.custom_functions import CustomDefinition, Grain, user_code_error
from granular.effects.effect import EffectContext
from granular.shared.errors import InputError
from granular.shared.message_text import one_line

# Far above the error of the difference quotient, some 1e-11, and far below that of a wrong factor.
CLOSE = 1e-5
"""Relative difference between a derivative and what a function says."""
# Fourth-order differences at this step err by 1e-16 by truncation and 1e-12 by rounding.
_STEP = 1e-4
# Neither round nor symmetric, lest a wrong function be right by chance; a zero crossing hides an error.
_POINTS, _TIMES = ((0.31, 0.17), (0.52, 0.83), (0.77, 0.44)), (0.0, 0.37, 1.9)
_DISTANCES = (0.83, 1.21, 1.94)


def check_effect_functions(definition: CustomDefinition, p: Any, context: EffectContext) -> None:
    """Check an effect's functions against each other at a few points, in plain Python."""
    functions = definition.functions
    width = context.cell.width / context.scales.length
    ends = len(context.grains.species)
    mass, moment = context.grains.mass_ratios(), context.grains.moment_ratios()
    grains = [
        Grain(x * width, y * width, float(mass[k % ends]), float(moment[k % ends]))
        for k, (x, y) in enumerate(_POINTS)
    ]
    if "force" in functions:
        for grain, time in itertools.product(grains, _TIMES):
            _check_force(definition, p, grain, time)
    if "pair_force" in functions:
        for r in _DISTANCES:
            _check_pair_force(definition, p, r, grains)
    if "flow" in functions:
        for grain in grains:
            _check_flow(definition, p, grain)


def check_wall_functions(definition: CustomDefinition, p: Any) -> None:
    """Check that a wall law's force is minus the slope of its energy, at a few distances."""
    for w in _DISTANCES:

        def energy(distance: float) -> float:
            return float(_call_user_function(definition, "energy", p, distance))

        result = _call_user_function(definition, "force", p, w)
        _compare_with_derivative(
            definition, "force", result, -_numerical_derivative(energy, w), 1e-6 * abs(energy(w))
        )


def check_functions_compile(definition: CustomDefinition, p: Any) -> None:
    """Compile each function of an effect that kernels call."""
    grain = Grain(1.5, 1.5, 1.0, 1.0)
    pair = (p, 1.5, grain, grain)
    arguments: dict[str, tuple[Any, ...]] = {
        "flow": (p, grain, 0.1, 0.1, 0.1),
        "pair_energy": pair,
        "pair_force": pair,
        "pair_stiffness": pair,
        "reach": (p,),
        "frequency": (p,),
    }
    for name, kernel in definition.kernels.items():
        if name in ("reach", "frequency"):
            continue  # called by Python alone
        try:
            kernel(*arguments.get(name, (p, grain, 0.0)))
        except NumbaError as error:
            raise InputError(
                f"{definition.display_name}: {name!r} does not compile: {_main_error_line(error)}; take "
                "arithmetic, math, and functions that are compiled themselves"
            ) from None


def _main_error_line(error: BaseException) -> str:
    """Line of the compiler's message that tells the most."""
    lines = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()]
    shown = [line for line in lines if line and not line.startswith(("Failed in", "During", "File"))]
    return one_line(shown[0] if shown else type(error).__name__)


def _call_user_function(definition: CustomDefinition, name: str, *arguments: Any, count: int = 1) -> Any:
    try:
        result = definition.functions[name](*arguments)
        values = (result,) if count == 1 else tuple(result)
        numbers = [float(value) for value in values]
    except Exception as error:
        raise user_code_error(definition, f"{name!r} fails", error) from None
    if len(numbers) != count:
        raise InputError(f"{definition.display_name}: {name!r} gives {len(numbers)} numbers, not {count}")
    return numbers[0] if count == 1 else numbers


def _numerical_derivative(function: Callable[[float], float], at: float) -> float:
    """Return the derivative, to the fourth order in the step."""
    h = _STEP * max(1.0, abs(at))
    near = function(at + h) - function(at - h)
    far = function(at + 2.0 * h) - function(at - 2.0 * h)
    return (8.0 * near - far) / (12.0 * h)


def _compare_with_derivative(
    definition: CustomDefinition, name: str, result: float, slope: float, size: float
) -> None:
    if not (math.isfinite(result) and math.isfinite(slope)):
        return  # a place where it cannot be evaluated says nothing
    if abs(result - slope) > CLOSE * max(abs(slope), abs(result), size):
        raise InputError(
            f"{definition.display_name}: {name!r} gives {result:.6g} where its energy asks for "
            f"{slope:.6g} (natural units); correct one of them"
        )


def _check_force(definition: CustomDefinition, p: Any, grain: Grain, time: float) -> None:
    def energy(position: Grain, moment: float) -> float:
        return float(_call_user_function(definition, "energy", p, position, moment))

    fx, fy = _call_user_function(definition, "force", p, grain, time, count=2)
    size = 1e-6 * abs(energy(grain, time))
    across = _numerical_derivative(lambda x: energy(grain._replace(x=x), time), grain.x)
    along = _numerical_derivative(lambda y: energy(grain._replace(y=y), time), grain.y)
    # One part in 1e3 of the other component counts as size: near a zero of this one, rounding of both
    # remains.
    _compare_with_derivative(definition, "force", fx, -across, size + 1e-3 * abs(fy))
    _compare_with_derivative(definition, "force", fy, -along, size + 1e-3 * abs(fx))
    rate = _numerical_derivative(lambda moment: energy(grain, moment), time)
    power = (
        _call_user_function(definition, "power", p, grain, time) if "power" in definition.functions else 0.0
    )
    _compare_with_derivative(definition, "power", power, rate, size)
    if "stiffness" in definition.functions:
        _call_user_function(definition, "stiffness", p, grain, time)


def _check_pair_force(definition: CustomDefinition, p: Any, r: float, grains: list[Grain]) -> None:
    for first, second in itertools.combinations_with_replacement(grains, 2):

        def energy(distance: float, first: Grain = first, second: Grain = second) -> float:
            return float(_call_user_function(definition, "pair_energy", p, distance, first, second))

        result = _call_user_function(definition, "pair_force", p, r, first, second)
        _compare_with_derivative(
            definition, "pair_force", result, -_numerical_derivative(energy, r), 1e-6 * abs(energy(r))
        )
        other = _call_user_function(definition, "pair_force", p, r, second, first)
        if not np.isclose(result, other, rtol=1e-9, atol=0.0, equal_nan=True):
            raise InputError(
                f"{definition.display_name}: 'pair_force' gives {result:.6g} and, with the grains "
                f"exchanged, {other:.6g}; a pair must pull and push equally"
            )
        if "pair_stiffness" in definition.functions:
            _call_user_function(definition, "pair_stiffness", p, r, first, second)


def _check_flow(definition: CustomDefinition, p: Any, grain: Grain) -> None:
    for vx, vy, dt in ((0.3, -0.2, 0.1), (0.0, 0.5, 0.02)):
        wx, wy = _call_user_function(definition, "flow", p, grain, vx, vy, dt, count=2)
        # 1e-12: what rounding may add to a flow that takes nothing, a rotation for example.
        if wx * wx + wy * wy > (vx * vx + vy * vy) * (1.0 + 1e-12):
            raise InputError(
                f"{definition.display_name}: 'flow' makes a grain faster; it may only take energy"
            )
        # Half a step before and half behind the drift must be a whole one, or the splitting loses its order.
        twice = _call_user_function(definition, "flow", p, grain, wx, wy, dt, count=2)
        total = _call_user_function(definition, "flow", p, grain, vx, vy, 2.0 * dt, count=2)
        if not np.allclose(twice, total, rtol=1e-9, atol=1e-14):
            raise InputError(
                f"{definition.display_name}: 'flow' over two spans is not that over both together; "
                "solve it exactly, as v*exp(-rate*dt)"
            )
