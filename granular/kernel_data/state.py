"""State and constants of a run: plain padded arrays in natural units.

A compensated sum stores the rounding error of each addition and adds it to the next increment (Kahan, Commun.
ACM 8 (1965) 40; for integrators Hairer, Lubich and Wanner, Geometric Numerical Integration (2006), VIII.5).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.far_field import FarFieldSettings, FarFieldState
from granular.pairs.grain_arrays import STIFFNESS, GrainArrays, value_or_one
from granular.pairs.near_law import NearLaw
from granular.pairs.near_list import NearList, VerletSettings
from granular.pairs.stripes import CutOffSettings, Stripes
from granular.shared.array_types import Float, Int


class EffectLaws(NamedTuple):
    """Laws of the active effects; inactive effects are None or missing, and are not compiled."""

    laws: tuple[Any, ...]  # one per effect except the dipole, in loop order
    host: Any  # law of bodies other than the piston, and of springs
    dipole: bool | None  # sum over all pairs: of dipoles, discs, or the tails of pair laws
    sides: tuple[Any, ...]  # sides of the cell with their laws: see `granular.effects.wall_side`
    weight: Float[Array, "m"] | None  # with plate friction: weight_j of the sums of 1/r^3
    cut: CutOffSettings | None  # cut-off of pairs; without it and the list: all pairs
    listing: VerletSettings | None  # de Paula's list
    far: FarFieldSettings | None  # far field beyond the smooth cut-off of pairs
    nearest: Float[Array, "3"] | None  # for a periodic direct sum: side lengths, and the radius [D]
    charges: Float[Array, "m"] | None = None  # in the pair sum: moments, or roots of the tails; None: 1
    series: Float[Array, "8"] | None = None  # for discs: see `granular.pairs.grain_arrays.COMMON`
    shift: Float[Array, "m"] | None = None  # for different discs: part of each grain in b [D^2]
    near: NearLaw | None = None  # for discs: correction of close pairs to the pair sum

    @property
    def periods(self) -> tuple[float, float] | None:
        """Side lengths of a periodic cell [D]."""
        if self.nearest is not None:
            return float(self.nearest[0]), float(self.nearest[1])
        return None if self.cut is None else self.cut.periods


class BodyResistance(NamedTuple):
    """Drag and friction of a guide, which resist the motion of a body."""

    rate: float  # decay rate of the velocity [1/tau]
    force: float  # Coulomb friction [F*]


class Constants(NamedTuple):
    """Constants of a run; they change only when a grain leaves."""

    grains: int  # number of grains
    masses: Float[Array, "m"] | None  # relative to the first species; None: all masses and moments equal
    # A second array here made a step of 92 grains 10 % slower. Kernels use `relative_moments`.
    moments: Float[Array, "m"] | None  # relative to the first species; None: same numbers as the masses
    minimum_mass: float  # of the grain that others can approach most closely
    minimum_moment: float  # of the same grain
    minimum_ratio: float  # minimum of moment over mass
    piston_mass: float  # [m]; inf: not given
    piston_weight: float  # [F*]
    resistance: BodyResistance | None
    exit: float  # height below which a grain has left [D]; -inf: no gap
    acting: EffectLaws
    threaded: bool | None  # None: one thread


@compiled(inline=True)
def relative_moments(constants: Constants) -> Float[Array, "m"] | None:
    """Magnetic moment of each grain relative to the first species; None if all are equal."""
    return _values_or_default(constants.moments, constants.masses)


@compiled(inline=True)
def pair_stiffness_bound_over_dipoles(series: Float[Array, "8"] | None) -> float:
    """Upper bound of a pair's stiffness at the distance rho [D], in units of 3/rho^5 (two dipoles)."""
    return 1.0 if series is None else series[STIFFNESS]


@compiled(inline=True)
def _values_or_default(values: Array | None, otherwise: Array | None) -> Array | None:
    return otherwise if values is None else values


@compiled
def multiply_by_moment_over_mass(
    stiffness: Float[Array, "m"],
    moments: Float[Array, "m"] | None,
    masses: Float[Array, "m"] | None,
    count: int,
) -> None:
    """Convert stiffness for a unit moment [F*/D] to stiffness per mass [1/tau^2], for each grain."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= moments[i] / value_or_one(masses, i)


X, Y, VX, VY = range(4)
"""Row indices of arrays with positions and velocities of the grains."""

CELL, PISTON = range(2)
"""Row indices of cell and piston in a state, as in `granular.schema.cell`; other pistons follow."""

HEIGHT, SPEED, HEIGHT_ROUNDING, SPEED_ROUNDING = range(4)
"""Column indices of a body's row in a state."""

TIME, DENSITY, SQUARE, LEAST, SHORTEST, LONGEST, STEPS = range(7)
"""Indices of the entries of a state's clock:

- `TIME`: time in the stage.
- `DENSITY`: density of steps.
- `SQUARE`: squared speed on which the density of steps depends.
- `LEAST`: minimum density of steps.
- `SHORTEST`, `LONGEST`: shortest and longest step so far.
- `STEPS`: number of steps in the run."""

WORK, PISTON_LOSS, LOSSES = range(3)
"""Indices of the entries of the energy ledger: external work; energy lost by the piston; from `LOSSES` on,
the energy lost to each effect, in the order of the laws."""


class RungeKuttaStageSlopes(NamedTuple):
    """Rates of change at the stages of a Runge-Kutta step, followed by the state at the start of the step."""

    grains: Float[np.ndarray, "s+1 4 m"]  # rows x, y [D/tau], vx, vy [D/tau^2]; last: state at the start
    piston: Float[np.ndarray, "s+1 2"]  # height [D/tau], speed [D/tau^2]; last: state at the start


class State(NamedTuple):
    """State of bed and piston, and scratch arrays of the loop."""

    x: Float[np.ndarray, "m"]  # padded [D]
    y: Float[np.ndarray, "m"]  # [D]
    vx: Float[np.ndarray, "m"]  # [D/tau]
    vy: Float[np.ndarray, "m"]  # [D/tau]
    fx: Float[np.ndarray, "m"]  # magnetic force, weight, contact, inertial force [F*]
    fy: Float[np.ndarray, "m"]  # [F*]
    bodies: Float[np.ndarray, "b 4"]  # height [D], speed [D/tau], rounding error of each
    piston: Float[np.ndarray, "4"]  # the row of the piston in them
    ledger: Float[np.ndarray, "2+laws"]  # external work; losses of the piston and to each law [F* D]
    clock: Float[np.ndarray, "7"]  # entries `TIME` to `STEPS`
    wall_forces: Float[np.ndarray, "sides"]  # of the grains on each side of the cell, outwards [F*]
    label: Int[np.ndarray, "m"]  # index in the scene of each grain
    load: Float[np.ndarray, "m"] | None  # sums of 1/r^3 for the normal force of friction [1/D^3]
    stripes: Stripes | None
    verlet_list: NearList | None
    far_forces: FarFieldState | None
    near: NearList | None  # close pairs of discs
    workspaces: tuple[Any, ...]  # scratch of each law, or None; zero after the last grain
    host: Any  # workspace of the bodies
    scratch: Float[np.ndarray, "m"]  # for sums over the grains; zero after the last grain
    buffers: Float[np.ndarray, "parts 5 m"] | None  # scratch of the direct sum
    rounding: Float[np.ndarray, "4 m"] | None  # errors of x, y [D], vx, vy [D/tau]; None: plain sums
    slopes: RungeKuttaStageSlopes | None


class MeasurementScratchArrays(NamedTuple):
    """Scratch arrays for the measurement of energies and stiffness."""

    stiffness: Float[np.ndarray, "m"]  # upper bounds of the squared frequencies [1/tau^2]
    energy_and_closest: Float[np.ndarray, "2"]  # see `granular.pairs.grain_arrays.GrainArrays`
    against_piston: Float[np.ndarray, "m"]  # stiffness of each grain against the piston [1/tau^2]


class Bed(NamedTuple):
    """State and constants of the bed, passed to kernels by reference."""

    state: State
    constants: Constants


@compiled(inline=True)
def grain_arrays_of_bed(
    bed: Bed,
    fx: Array,
    fy: Array,
    stiffness: Array | None,
    energy_and_closest: Array | None,
    load: Array | None,
) -> GrainArrays:
    """Return one `GrainArrays` with the grains' arrays and the arrays for the results of pair sums."""
    x, y, acting = bed.state.x, bed.state.y, bed.constants.acting
    charges, weight, series, shift = acting.charges, acting.weight, acting.series, acting.shift
    return GrainArrays(x, y, fx, fy, charges, stiffness, energy_and_closest, load, weight, series, shift)


PERSISTENT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces", "label")
"""Fields of the state that are stored in a checkpoint; all others are scratch arrays."""


@compiled
def compensated_sum_and_rounding_error(
    total: float, rounding: float, increment: float
) -> tuple[float, float]:
    """Return the sum of a total and an increment, and the rounding error of the sum (Kahan 1965)."""
    corrected = increment + rounding
    new = total + corrected
    return new, corrected - (new - total)


@compiled
def add_to_velocity(
    rounding: Float[Array, "4 m"] | None, state: State, i: int, by_x: float, by_y: float
) -> None:
    """Add to a velocity [D/tau], with a compensated sum if rounding errors are stored."""
    if rounding is None:
        state.vx[i] += by_x
        state.vy[i] += by_y
    else:
        state.vx[i], rounding[VX, i] = compensated_sum_and_rounding_error(state.vx[i], rounding[VX, i], by_x)
        state.vy[i], rounding[VY, i] = compensated_sum_and_rounding_error(state.vy[i], rounding[VY, i], by_y)


@compiled
def cubic_spline_value_and_slope(values: Array, slopes: Array, h: float, time: float) -> tuple[float, float]:
    """Return value and slope of a spline with the knot spacing ``h``; constant outside the knots."""
    k = min(max(int(time / h), 0), values.size - 2)
    s = min(max(time / h - k, 0.0), 1.0)
    rise, left, right = values[k + 1] - values[k], h * slopes[k], h * slopes[k + 1]
    bend, twist = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    return values[k] + s * (left + s * (bend + s * twist)), (left + s * (2.0 * bend + 3.0 * s * twist)) / h
