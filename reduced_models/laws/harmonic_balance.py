"""Stiffness and damping of a law in harmonic cycles, z = centre + A cos(omega t).

They are the first harmonics of its force (describing functions; Krylov & Bogoliubov 1943, Gelb &
Vander Velde 1968): damping over twice the root of stiffness is the energy that a cycle dissipates,
over 4 pi that of its swing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from reduced_models.laws.equation import compiled_field
from reduced_models.laws.law import Law
from reduced_models.laws.small_swing import acceleration_of

if TYPE_CHECKING:
    import sympy

Rates = Callable[..., Sequence[Any]]
"""From z, its velocity and hidden states to z'' and the rates of the hidden states."""

_NODES = 256  # of a cycle
_TURNS = 3  # after which a hidden state is taken to repeat itself
_MOST_STEPS = 60
_SETTLED = 1e-11
_STEP, _FARTHEST = 1e-4, 0.3  # of Newton's method for a centre, in amplitudes


class Cycles(NamedTuple):
    """Harmonic cycles, per unit of mass.

    Attributes
    ----------
    centre : float64 (n,)
        Mean of z, at which no mean force is needed.
    frequency : float64 (n,)
        Angular [rad/s].
    stiffness, damping : float64 (n,)
        Equivalent ones [1/s^2], [1/s]. NaN where a cycle leaves where the law is defined.
    """

    centre: np.ndarray
    frequency: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    @property
    def damping_ratio(self) -> np.ndarray:
        """Fraction of critical damping; NaN where nothing pulls back."""
        with np.errstate(all="ignore"):
            return np.asarray(self.damping / (2.0 * np.sqrt(self.stiffness)))

    def resistance(self, amplitude: Any) -> np.ndarray:
        """Constant friction, per unit of mass, that takes as much energy from such a cycle."""
        return np.asarray(0.25 * math.pi * amplitude * self.frequency * self.damping)


def rates_of(law: Law, values: Sequence[Any]) -> Rates:
    """The rates of a law with values of its parameters, numbers or arrays; inputs are at zero."""
    field, still = compiled_field(law.equation, law.inputs, "numpy"), (0.0,) * len(law.inputs)
    return lambda *state: field(*state, *still, *values)


def rates_of_equation(equation: sympy.Eq) -> Rates:
    """The rate of an equation in z(t) with numbers for all parameters."""
    from granular.formulas.algebra import function_of

    rate, state = acceleration_of(equation)
    return function_of(state, [rate])


def cycles(
    rates: Rates, hidden: int, amplitude: Any, centre: Any, omega: Any, *, free: bool = True
) -> Cycles:
    """The cycles of given amplitudes (n,), from guesses of their centres and frequencies.

    Free ones swing at the frequency at which the equivalent stiffness carries the inertia, others
    at the given one. A stiffness that is not above zero is returned as it is.
    """
    amplitude, centre, omega = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(each, dtype=np.float64)) for each in (amplitude, centre, omega))
    )
    for _ in range(_MOST_STEPS):
        moved, stiffness, damping = centred(rates, hidden, amplitude, centre, omega)
        swings = stiffness > 0.0
        faster = np.sqrt(np.where(swings, stiffness, omega**2)) if free else omega
        changed = np.maximum(abs(moved - centre) / amplitude, abs(faster / omega - 1.0))
        centre, omega = moved, faster
        if not (swings & (changed > _SETTLED)).any():
            break
    return Cycles(centre, omega, stiffness, damping)


def centred(
    rates: Rates, hidden: int, amplitude: np.ndarray, centre: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres moved by a Newton step to no mean force; stiffness and damping before the step."""
    step = _STEP * amplitude
    places = np.stack([centre, centre + step])
    mean, stiffness, damping = harmonics(rates, hidden, amplitude, places, omega)
    with np.errstate(all="ignore"):
        change = mean[0] * step / (mean[1] - mean[0])
    change = np.clip(np.nan_to_num(change), -_FARTHEST * amplitude, _FARTHEST * amplitude)
    return centre - change, stiffness[0], damping[0]


def harmonics(
    rates: Rates, hidden: int, amplitude: np.ndarray, centre: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean force, stiffness [1/s^2] and damping [1/s] of cycles; the shapes are broadcast."""
    # None of them where the velocity is zero, and its sign rounding.
    angles = 2.0 * math.pi * (np.arange(_NODES) + 0.5) / _NODES

    def motion(angle: float) -> tuple[np.ndarray, np.ndarray]:
        return centre + amplitude * math.cos(angle), -amplitude * omega * math.sin(angle)

    still = np.zeros(np.broadcast_shapes(*map(np.shape, (amplitude, centre, omega))))
    states, half = [still] * hidden, math.pi / _NODES
    sums = [still] * 3
    with np.errstate(all="ignore"):
        for turn in range(_TURNS if states else 1):
            last = turn == (_TURNS if states else 1) - 1
            for angle in angles:
                force, *slopes = rates(*motion(angle), *states)
                if last:
                    parts = (-0.5, -math.cos(angle), math.sin(angle))
                    sums = [each + part * force for each, part in zip(sums, parts, strict=True)]
                if states:
                    # The explicit midpoint rule: the cycle of z is given.
                    middle = [
                        w + half * slope / omega for w, slope in zip(states, slopes, strict=True)
                    ]
                    _, *slopes = rates(*motion(angle + half), *middle)
                    states = [
                        w + 2.0 * half * slope / omega
                        for w, slope in zip(states, slopes, strict=True)
                    ]
    mean, stiffness, damping = (2.0 / _NODES * each for each in sums)
    return mean, stiffness / amplitude, damping / (amplitude * omega)
