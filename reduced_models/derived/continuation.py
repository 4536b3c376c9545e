"""The equilibria of a bed under its piston held at one height after the other, up to an instability.

Each height starts from the one before, moved along the static response to the piston. A bed loses its
equilibrium when the lowest eigenvalue of its stiffness goes through zero: beyond that height grains
rearrange, and the piston's force jumps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import find_equilibrium, held_shifts
from granular.linear.pencil import Pencil
from granular.linear.relaxation import RELAXED, relax
from granular.linear.roots import refine_root, static_shape
from granular.shared.errors import InputError

RESOLUTION = 1e-4
"""Shortest step of the piston [D], and so the error of an instability's height."""

_KICK = 1e-2  # displacement along the unstable mode [D]: beyond what a saddle holds at the shortest step
_MOVED = 0.25  # of the largest displacement, from which on a grain is said to rearrange


class HeldState(NamedTuple):
    """An equilibrium with the piston held, and its oscillator (M + m) s^2 + c s + k = 0."""

    height: float  # [m]
    force: float  # F, that pulls the piston down over its own weight [N]
    stiffness: float  # k = dF/dz [N/m]
    mass: float  # M + m [kg]
    damping: float  # c [N s/m]
    root: complex  # s [1/s]


class Instability(NamedTuple):
    """A height at which the equilibrium under the held piston ends.

    Attributes
    ----------
    height : float
        Height of the piston [m], to 1e-4 D.
    grains : tuple of int
        Grains that move by a quarter of the largest displacement or more.
    force_drop : float
        Bed's force on the piston before grains rearrange, minus the one behind, at this height [N]; 0 if they
        move away gradually.
    """

    height: float
    grains: tuple[int, ...]
    force_drop: float


def held_state(pencil: Pencil, piston: int, s: complex) -> HeldState:
    """Oscillator of a held equilibrium, whose root is next to s [1/s]."""
    root, shape, height = refine_root(pencil, piston, s), static_shape(pencil, piston), pencil.at[piston]
    if root is None:
        raise InputError(
            f"the piston has no oscillation at a height of {1e3 * height:.4g} mm; lower the drag or the reach"
        )
    stiffness, s = float(shape @ pencil.times(0.0, shape)), root.s
    mass, damping = np.linalg.solve([[(s * s).real, s.real], [(s * s).imag, s.imag]], [-stiffness, 0.0])
    force = -float(pencil.bed.forces(pencil.at)[piston])
    return HeldState(float(height), force, stiffness, float(mass), float(damping), s)


def follow_piston(
    pencil: Pencil, piston: int, s: complex, step: float, count: int
) -> tuple[list[HeldState], Instability | None]:
    """Follow the equilibrium by ``count`` signed steps of the piston [m], up to the first instability."""
    states: list[HeldState] = []
    start = float(pencil.at[piston])
    for k in range(1, count + 1):
        pencil, reached = _advance(pencil, piston, start + k * step)
        if not reached:
            return states, _instability(pencil, piston, float(np.sign(step)))
        states.append(held_state(pencil, piston, s))
        s = states[-1].root
    return states, None


def _advance(pencil: Pencil, piston: int, goal: float) -> tuple[Pencil, bool]:
    """Matrices at the goal [m], or at the last height before an instability; which of both."""
    size = goal - pencil.at[piston]
    while (left := goal - pencil.at[piston]) != 0.0:
        height = goal if abs(left) <= abs(size) else float(pencil.at[piston] + size)
        trial = _next_equilibrium(pencil, piston, height)
        if trial is not None:
            pencil = trial
        elif abs(size) <= RESOLUTION * pencil.bed.length:
            return pencil, False
        else:
            size *= 0.5
    return pencil, True


def _next_equilibrium(pencil: Pencil, piston: int, height: float) -> Pencil | None:
    """Return the stable equilibrium at a height [m] that continues the present one, if there is one."""
    step, held = height - float(pencil.at[piston]), _held(pencil.bed, piston)
    start = pencil.at + step * static_shape(pencil, piston)
    start[piston] = height
    try:
        result = find_equilibrium(pencil.bed, start, held, pencil)
    except InputError:
        return None
    # Another branch is farther from the extrapolation than the piston's step, which the curvature is not.
    if np.abs(result.at - start).max() > abs(step) or not result.is_stable(held):
        return None
    return result


def _held(bed: BedForces, piston: int) -> tuple[int, ...]:
    return (piston, *held_shifts(bed))


def _instability(pencil: Pencil, piston: int, direction: float) -> Instability:
    """Find what happens beyond the last height before an instability."""
    bed, held = pencil.bed, _held(pencil.bed, piston)
    at, mode = pencil.at.copy(), pencil.lowest_modes(1, held)[1][:, 0]
    at[piston] += direction * RESOLUTION * bed.length
    side = 1.0 if mode @ bed.forces(at) >= 0.0 else -1.0
    kick = side * _KICK * bed.length / float(np.abs(mode).max())
    stiffness = pencil.stiffness.diagonal()
    relaxed = relax(bed, at + kick * mode, held, stiffness, RELAXED)
    moved = np.linalg.norm(bed.positions(relaxed) - bed.positions(pencil.at), axis=1)
    grains = tuple(map(int, np.flatnonzero(moved >= _MOVED * moved.max())))
    relaxed[piston] = pencil.at[piston]
    try:
        after = find_equilibrium(bed, relaxed, held).at
    except InputError:  # the bed is about to rearrange again
        after = relax(bed, relaxed, held, stiffness, RELAXED)
    drop = float(bed.forces(pencil.at)[piston] - bed.forces(after)[piston])
    return Instability(float(pencil.at[piston]), grains, drop)
