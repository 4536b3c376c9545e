"""Law whose force, mass and damping are polynomials of the height, and its backbone.

The equilibria of a bed under its piston held at one height after the other, up to an instability.

Each height starts from the one before, moved along the static response to the piston. A bed loses its
equilibrium when the lowest eigenvalue of its stiffness goes through zero: beyond that height grains
rearrange, and the piston's force jumps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import RELAXED, find_equilibrium, held_shifts, relax
from granular.linear.pencil import Pencil
from granular.linear.roots import refine_root, static_shape
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from reduced_models.laws.law import Law
from reduced_models.models.ports import DERIVED
from reduced_models.models.quantities import format_percent
from reduced_models.records.backbone import Backbone

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


RESIDUAL = 1e-5
"""Residual of a polynomial over its largest value (of the force and of its slope) that ends its growth."""

HIGHEST_ORDER = 9

LARGEST_RESIDUAL = 0.01
"""Residual of a polynomial over its largest value from which on a law is refused: it would be as wrong."""

# Of a half cycle: the midpoint rule of a smooth periodic function converges faster than any power.
_NODES = 64
_MOST_STEPS = 50


def polynomial_law(
    states: Sequence[HeldState], middle: int, order: int | None
) -> tuple[Law, dict[str, float], str]:
    """Law with its values, and the orders and residuals of its polynomials in words."""
    heights, at = np.array([state.height for state in states]), states[middle]
    distances = np.abs(heights - at.height)
    fits = _fits(states, at, order)
    worst = max(fits, key=lambda name: fits[name][1])
    if order is None and fits[worst][1] > LARGEST_RESIDUAL:
        for reach in np.unique(distances)[:0:-1]:
            near = [state for state, away in zip(states, distances, strict=True) if away <= reach]
            if max(residual for _, residual in _fits(near, at, order).values()) <= LARGEST_RESIDUAL:
                break
        raise InputError(
            f"no polynomial of the height follows the {worst} from {1e3 * heights[0]:.4g} to "
            f"{1e3 * heights[-1]:.4g} mm within {format_percent(LARGEST_RESIDUAL)}: the bed nearly "
            f"rearranges there; give a reach of {0.995e3 * reach:.3g} mm"
        )
    k, m, c = (coefficients / at.mass for coefficients, _ in fits.values())
    values = {f"m{j}": float(m[j]) for j in range(1, len(m))} | {"rest": at.height}
    values |= {f"c{j}": float(c[j]) for j in range(len(c))} | {f"k{j}": float(k[j]) for j in range(1, len(k))}
    inertia = ["1", *(_term(f"m{j}", j) for j in range(1, len(m)))]
    gradient = [_term(f"{j}*m{j}/2" if j > 1 else "m1/2", j - 1) for j in range(1, len(m))]
    parts = [f"({' + '.join(inertia)})*z''", f"({' + '.join(gradient)})*z'**2"][: 1 + bool(gradient)]
    parts += [f"({' + '.join(_term(f'c{j}', j) for j in range(len(c)))})*z'"]
    parts += [_term(f"k{j}", j) for j in range(1, len(k))]
    units = {"rest": "m", **{name: _unit(name[0], int(name[1:])) for name in values if name != "rest"}}
    law = Law(DERIVED, f"{' + '.join(parts)} = 0", units=units, source="equilibria and roots of the bed")
    accuracy = (
        f"{name} of order {len(coefficients) - 1}, residual {format_percent(residual)}"
        for name, (coefficients, residual) in fits.items()
    )
    return law, {name: values[name] for name in law.parameters}, ", ".join(accuracy)


def _fits(
    states: Sequence[HeldState], at: HeldState, order: int | None
) -> dict[str, tuple[Float[np.ndarray, "p"], float]]:
    """Coefficients and residuals of force, mass and damping about a state."""
    height, force, stiffness, mass, damping, _ = np.array(states).real.T
    x, less = height - at.height, None if order is None else order - 1
    return {
        "force": _fit_polynomial(x, force, (0.0, at.stiffness), order, stiffness),
        "mass": _fit_polynomial(x, mass, (at.mass,), less),
        "damping": _fit_polynomial(x, damping, (at.damping,), less),
    }


def _term(factor: str, power: int) -> str:
    return factor + ("" if power == 0 else "*(z - rest)" if power == 1 else f"*(z - rest)**{power}")


def _unit(kind: str, power: int) -> str:
    """Return the unit of a coefficient of inertia, damping or force over the mass, by its power."""
    seconds = {"m": 0, "c": 1, "k": 2}[kind]
    metres = power - (kind == "k")
    below = [f"{unit}^{size}" if size > 1 else unit for unit, size in (("m", metres), ("s", seconds)) if size]
    return f"1/({' '.join(below)})" if len(below) > 1 else f"1/{below[0]}"


def _fit_polynomial(
    x: Float[np.ndarray, "n"],
    values: Float[np.ndarray, "n"],
    known: tuple[float, ...],
    order: int | None,
    slopes: Float[np.ndarray, "n"] | None = None,
) -> tuple[Float[np.ndarray, "p"], float]:
    """Coefficients of a polynomial of known lowest ones, and its largest residual over the largest value."""
    reach = float(np.abs(x).max())
    u = x / reach
    target = values if slopes is None else np.concatenate([values, reach * slopes])
    lowest, highest = len(known) - 1, min(HIGHEST_ORDER, len(target) // 2)
    for degree in range(lowest, highest + 1) if order is None else [max(order, lowest)]:
        powers = np.arange(degree + 1)
        columns = u[:, None] ** powers
        if slopes is not None:
            columns = np.concatenate([columns, powers * u[:, None] ** np.maximum(powers - 1, 0)])
        coefficients = np.zeros(degree + 1)
        coefficients[: len(known)] = np.array(known) * reach ** powers[: len(known)]
        left = target - columns @ coefficients
        coefficients[len(known) :] = np.linalg.lstsq(columns[:, len(known) :], left, rcond=None)[0]
        # A bed without drag has no damping anywhere.
        largest = float(np.abs(target).max()) or 1.0
        residual = float(np.abs(target - columns @ coefficients).max()) / largest
        if residual <= RESIDUAL:
            break
    return coefficients / reach**powers, residual


def energy_backbone(values: Mapping[str, float], amplitudes: Sequence[float]) -> Backbone:
    """Backbone [m, rad/s] of the undamped law, and damping by the energy lost along its cycles."""
    # The lowest coefficients of inertia and force by the height over rest are no parameters.
    laws = tuple(
        np.polynomial.Polynomial([*lowest, *(value for name, value in values.items() if name[0] == kind)])
        for kind, lowest in (("m", [1.0]), ("c", []), ("k", [0.0]))
    )
    frequency, ratio = np.array([_cycle(laws, amplitude) for amplitude in amplitudes]).T
    none = np.zeros(len(frequency))
    return Backbone("energy", np.asarray(amplitudes, dtype=float), frequency, ratio, none, none)


def _cycle(laws: tuple[np.polynomial.Polynomial, ...], amplitude: float) -> tuple[float, float]:
    """Angular frequency [rad/s] and damping ratio of a cycle of an amplitude [m]."""
    inertia, damping, force = laws
    if not amplitude > 0.0:
        raise InputError(f"amplitude = {amplitude:g} m; give one above 0")
    potential, centre = force.integ(), 0.0
    for _ in range(_MOST_STEPS):  # Newton's method for extremes of one energy
        low, high = centre - amplitude, centre + amplitude
        change = (potential(high) - potential(low)) / (force(high) - force(low))
        centre -= change
        if abs(change) < 1e-14 * amplitude:
            break
    low, high = centre - amplitude, centre + amplitude
    # With x = centre + amplitude sin(angle), energy less potential is (high - x)(x - low) times a polynomial.
    quotient = (potential(high) - potential) // np.polynomial.Polynomial([-low * high, low + high, -1.0])
    angles = math.pi * ((np.arange(_NODES) + 0.5) / _NODES - 0.5)
    x = centre + amplitude * np.sin(angles)
    if not (force(high) > 0.0 > force(low) and (quotient(x) > 0.0).all() and (inertia(x) > 0.0).all()):
        raise InputError(
            f"the force pulls no cycle of an amplitude of {amplitude:g} m back; give a smaller one"
        )
    pace = np.sqrt(2.0 * quotient(x) / inertia(x))  # speed over amplitude cos(angle)
    omega = 1.0 / float((1.0 / pace).mean())
    loss = 2.0 * math.pi * float((damping(x) * pace * np.cos(angles) ** 2).mean())
    return omega, loss / (2.0 * math.pi * omega**2)
