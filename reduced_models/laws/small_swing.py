"""The small swing of a law about its level of rest, where it has one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.laws.law import Law, compiled_field, compiled_slopes, slopes_of

if TYPE_CHECKING:
    import sympy

_MOST_STEPS = 50
Field = Callable[[float], float]
Slopes = Callable[[float], tuple[float, float]]


class SmallSwing(NamedTuple):
    """A motion so small that the law is linear; hidden states and inputs are at zero.

    Attributes
    ----------
    z : float
        Level of rest.
    period : float
        Of the undamped swing [s].
    damping_ratio : float
        Fraction of critical damping.
    """

    z: float
    period: float
    damping_ratio: float


def small_swing(law: Law, values: Sequence[float], z: float) -> SmallSwing | None:
    """That of a law with values of its parameters, about the level of rest near z.

    None where there is no stable level of rest.
    """
    force = compiled_field(law.equation, law.inputs, "numpy")
    slopes = compiled_slopes(law.equation, law.inputs)
    still = (0.0,) * (1 + len(law.hidden) + len(law.inputs))
    return _found(lambda z: force(z, *still, *values)[0], lambda z: slopes(z, *still, *values), z)


def swing_of_equation(equation: sympy.Eq, z: float) -> SmallSwing | None:
    """That of an equation in z(t) with numbers for all parameters; see `small_swing`."""
    import sympy

    from granular.shared.algebra import function_of

    t = sympy.Symbol("t")
    motion = sympy.Function("z")(t)
    height, speed, acceleration = sympy.symbols("z v a", real=True)
    plain = (equation.lhs - equation.rhs).xreplace(
        {motion.diff(t, 2): acceleration, motion.diff(t): speed, motion: height}
    )
    still = dict.fromkeys(plain.free_symbols - {height, speed, acceleration}, 0.0)
    plain = plain.subs(still)
    rate = -plain.subs(acceleration, 0) / plain.diff(acceleration)
    force = function_of([height, speed], rate)
    slopes = slopes_of(rate, height, speed, [height, speed])
    return _found(lambda z: force(z, 0.0), lambda z: slopes(z, 0.0), z)


def _found(force: Field, slopes: Slopes, z: float) -> SmallSwing | None:
    """By Newton's method."""
    with np.errstate(all="ignore"):
        for _ in range(_MOST_STEPS):
            slope = slopes(z)[0]
            change = force(z) / slope if slope else math.nan
            z -= change
            if not math.isfinite(z) or abs(change) <= 1e-15 * max(1.0, abs(z)):
                break
        stiffness, damping = (-slope for slope in slopes(z))
    if not math.isfinite(z) or not stiffness > 0.0:
        return None
    omega = math.sqrt(stiffness)
    return SmallSwing(float(z), 2.0 * math.pi / omega, damping / (2.0 * omega))
