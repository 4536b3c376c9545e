"""Eddy-current drag with the currents of all other grains, as a flow of second order.

The velocities obey m_i dv_i/dt = -sum_j q_i q_j T_ij v_j while the positions stand still, with T of
`granular.effects.eddy_drag_tensor`. With A = dt M^(-1) T, a step is v - A v + A^2 v/2: of second order
in ``dt``, and never a gain of energy while no eigenvalue of A exceeds 2, as T is positive; longer
steps are cut. The loss is that of the kinetic energy, to the last bit.

The sum goes over all pairs, each from both ends, so that its inner loop writes to a single row and
is vectorised. Of a high bed, grains whose heights differ by more than ``reach`` do not meet; a drag
on each grain, as large as what they could brake, then keeps the sum from giving energy.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.eddy_drag_tensor import FARTHEST, Plate, drag_tensor_polynomials, lone_disc_drag_factor
from granular.effects.effect import EffectContext
from granular.kernel_data.constants import relative_moments
from granular.kernel_data.state import LOSSES, Bed
from granular.pairs.direct_sum import pad_values
from granular.pairs.disc_law import Disc
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.sorting import sort_by_value

if TYPE_CHECKING:
    from jaxtyping import Float, Int

LEFT_OUT = 0.01
"""Drag of a lone grain, at most, that grains beyond the reach take or add."""

# 2/sqrt(3), and that over 1.375^2 (see `granular.effects.eddy_drag.SPACING`).
DENSEST, USUAL = 1.155, 0.61
"""Grains per D^2 that touch each other, and at the packaged damper's spacing."""

# 1 - A + A^2/2 is off by 0.019 at 0.5; from 2 on a step would gain energy.
LONGEST = 0.5
"""Largest eigenvalue of A in a step: the error of its exponential is 2 % there."""

PX, PY, INPUT_X, INPUT_Y, OUTPUT_X, OUTPUT_Y, SPEED_X, SPEED_Y, CHARGE = range(9)
"""Rows of the workspace: positions, what the tensor multiplies, what comes out, velocities, and
from there on the moments of each kind of grain, 0 for those of other kinds."""


class PairDragTable(NamedTuple):
    """The tensor of each pair of kinds of grains."""

    series: Float[np.ndarray, "k k 2 ORDER"] | None  # coefficients of P, Q by pairs of kinds; None: both 1
    shifts: Float[np.ndarray, "s 2"]  # displacements of the images of the cell, its own first [D]


class EddyWorkspace(NamedTuple):
    """Scratch of the sums."""

    rows: Float[np.ndarray, "8+k m"]  # see `PX` and the others [D, D/tau]
    order: Int[np.ndarray, "m"]  # grains by their height


class MutualEddyLaw(NamedTuple):
    """Eddy-current drag of all grains as the kernels take it."""

    rate: float  # [1/tau], of a lone dipole of the first species along a thin plate
    square: float  # H^2 [D^2]
    reach: float  # largest difference in height of grains that meet [D]
    spare: float  # drag for those beyond the reach, over a lone grain's
    stiffest: float  # bound of the eigenvalues of M^-1 T, over ``rate``
    kinds: int  # 1 of dipoles; of discs one per species
    kind: Float[Array, "m"] | None  # kind of each grain; None of one kind
    table: PairDragTable

    def workspace(self, size: int, count: int) -> EddyWorkspace:
        """Make the scratch arrays of the sums over pairs."""
        rows = np.zeros((CHARGE + self.kinds, size))
        return EddyWorkspace(rows, np.arange(size))

    @staticmethod
    @compiled
    def damp_velocities(
        law: MutualEddyLaw, workspace: EddyWorkspace, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Let the velocities decay by the eddy currents; enter the energy lost; dt [tau]."""
        state, constants = bed.state, bed.constants
        masses, count, rows, lost = constants.masses, constants.grains, workspace.rows, 0.0
        _load_grains_into_workspace(law, workspace, bed)
        steps = 1 + int(law.rate * law.stiffest * abs(dt) / LONGEST)
        h = dt / steps
        for _ in range(steps):
            for i in range(count):
                rows[INPUT_X, i], rows[INPUT_Y, i] = rows[SPEED_X, i], rows[SPEED_Y, i]
            _multiply_by_drag_tensor(law, workspace, count)
            for i in range(count):
                factor = h / value_or_one(masses, workspace.order[i])
                rows[INPUT_X, i] = factor * rows[OUTPUT_X, i]
                rows[INPUT_Y, i] = factor * rows[OUTPUT_Y, i]
            _multiply_by_drag_tensor(law, workspace, count)
            for i in range(count):
                mass = value_or_one(masses, workspace.order[i])
                x = 0.5 * h / mass * rows[OUTPUT_X, i] - rows[INPUT_X, i]
                y = 0.5 * h / mass * rows[OUTPUT_Y, i] - rows[INPUT_Y, i]
                vx, vy = rows[SPEED_X, i], rows[SPEED_Y, i]
                lost -= 0.5 * mass * (x * (2.0 * vx + x) + y * (2.0 * vy + y))
                rows[SPEED_X, i], rows[SPEED_Y, i] = vx + x, vy + y
        for i in range(count):
            grain = workspace.order[i]
            state.vx[grain], state.vy[grain] = rows[SPEED_X, i], rows[SPEED_Y, i]
        state.ledger[LOSSES + index] += lost
        return 0


@compiled
def _load_grains_into_workspace(law: MutualEddyLaw, workspace: EddyWorkspace, bed: Bed) -> None:
    """Put the grains into the workspace; in order of their heights where not all of them meet."""
    state, count, rows, order = bed.state, bed.constants.grains, workspace.rows, workspace.order
    moments = relative_moments(bed.constants)
    for i in range(count):
        order[i] = i  # a grain that left may have changed it
    if law.reach < np.inf:
        sort_by_value(order[:count], state.y)
    for i in range(count):
        grain = order[i]
        rows[PX, i], rows[PY, i] = state.x[grain], state.y[grain]
        rows[SPEED_X, i], rows[SPEED_Y, i] = state.vx[grain], state.vy[grain]
        for kind in range(law.kinds):
            rows[CHARGE + kind, i] = 0.0
        rows[CHARGE + _grain_kind(law.kind, grain), i] = value_or_one(moments, grain)


@compiled
def _multiply_by_drag_tensor(law: MutualEddyLaw, workspace: EddyWorkspace, count: int) -> None:
    """Multiply the input by T."""
    rows, series, shifts = workspace.rows, law.table.series, law.table.shifts
    y = rows[PY]
    begin = end = 0
    rows[OUTPUT_X, :count] = 0.0
    rows[OUTPUT_Y, :count] = 0.0
    for j in range(count):
        while y[j] - y[begin] > law.reach:
            begin += 1
        while end < count and not y[end] - y[j] > law.reach:
            end += 1
        own = _grain_kind(law.kind, workspace.order[j])
        charge = law.rate * rows[CHARGE + own, j]
        vx, vy = charge * rows[INPUT_X, j], charge * rows[INPUT_Y, j]
        for image in range(len(shifts)):
            at_x, at_y = rows[PX, j] + shifts[image, 0], y[j] + shifts[image, 1]
            for kind in range(law.kinds):
                _add_drag_of_grain(
                    rows[PX],
                    y,
                    rows[CHARGE + kind],
                    rows[OUTPUT_X],
                    rows[OUTPUT_Y],
                    begin,
                    end,
                    at_x,
                    at_y,
                    vx,
                    vy,
                    law.square,
                    _pair_polynomial_terms(series, kind, own),
                )
        spare = law.spare * rows[CHARGE + own, j]
        rows[OUTPUT_X, j] += spare * vx
        rows[OUTPUT_Y, j] += spare * vy


@compiled(inline=True)
def _grain_kind(kinds: Array | None, grain: int) -> int:
    return 0 if kinds is None else int(kinds[grain])


@compiled(inline=True)
def _pair_polynomial_terms(series: Array | None, kind: int, other: int) -> Array | None:
    return None if series is None else series[kind, other]


@compiled
def _add_drag_of_grain(
    x: Array,
    y: Array,
    charges: Array,
    sum_x: Array,
    sum_y: Array,
    begin: int,
    end: int,
    at_x: float,
    at_y: float,
    vx: float,
    vy: float,
    square: float,
    terms: Array | None,
) -> None:
    """Add what the motion of a grain does to grains of a kind."""
    # Slices begin at 0: an index that might be negative keeps Numba from vectorising.
    x, y, charges = x[begin:end], y[begin:end], charges[begin:end]
    sum_x, sum_y = sum_x[begin:end], sum_y[begin:end]
    if terms is None:
        for i in range(len(x)):
            dx, dy = x[i] - at_x, y[i] - at_y
            u = square / (dx * dx + dy * dy + square)
            power = charges[i] * u * u * math.sqrt(u)
            along = 5.0 / square * u * (dx * vx + dy * vy)
            sum_x[i] += power * (vx - along * dx)
            sum_y[i] += power * (vy - along * dy)
    else:
        p = _coefficients_as_tuple(terms[0])
        q = _coefficients_as_tuple(terms[1])
        for i in range(len(x)):
            dx, dy = x[i] - at_x, y[i] - at_y
            u = square / (dx * dx + dy * dy + square)
            power = charges[i] * u * u * math.sqrt(u)
            across = _polynomial(p, u)
            along = 5.0 / square * u * _polynomial(q, u) * (dx * vx + dy * vy)
            sum_x[i] += power * (across * vx - along * dx)
            sum_y[i] += power * (across * vy - along * dy)


@compiled(inline=True)
def _coefficients_as_tuple(c: Array) -> tuple[float, ...]:
    return c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11]


@compiled(inline=True)
def _polynomial(c: tuple[float, ...], u: float) -> float:
    """Sum of c_k u^k by Estrin's scheme, written out: Numba does not vectorise round a loop."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11 = c
    v = u * u
    w = v * v
    low = c0 + u * c1 + v * (c2 + u * c3)
    middle = c4 + u * c5 + v * (c6 + u * c7)
    high = c8 + u * c9 + v * (c10 + u * c11)
    return low + w * (middle + w * high)


def make_mutual_eddy_law(
    rate: float, plate: Plate, discs: tuple[Disc, ...], context: EffectContext
) -> MutualEddyLaw:
    """Make the law of the drag with mutual currents, for a bed; rate [1/tau]."""
    length = context.scales.length
    square = 4.0 * plate.distance**2
    periods = context.cell.periods
    shifts, reach = np.zeros((1, 2)), math.inf
    if periods is not None:
        sides = np.array(periods) / length
        numbers = [range(-math.ceil(FARTHEST / side), math.ceil(FARTHEST / side) + 1) for side in sides]
        shifts = np.array([(i * sides[0], j * sides[1]) for i in numbers[0] for j in numbers[1]])
    else:
        # Far away T ~ 4 H^5/r^5. Over all grains higher or lower by more than R that is 4 (8/9) rho H^5/R^3;
        # set to LEFT_OUT.
        reach = (32.0 / 9.0 * USUAL * square**2.5 / LEFT_OUT) ** (1.0 / 3.0)
        height = context.grains.count / USUAL / (context.cell.width / length)
        if height < 2.0 * reach:
            reach = math.inf
    made = _pair_polynomials(plate, discs)
    factor = max(
        (lone_disc_drag_factor(plate, disc) for disc in discs), default=plate.thickness_drag_factor()
    )
    moments = context.grains.moment_ratios()[context.species] * context.grains.moment_spread_factors()
    masses = context.grains.mass_ratios()[context.species]
    heaviest = float((moments**2 / masses).max())
    return MutualEddyLaw(
        rate=rate,
        square=square,
        reach=reach,
        spare=0.0 if reach == math.inf else LEFT_OUT * factor,
        # 1 for grains far apart, rho H^2 for dense ones. Touching, with H = 4/3 D, 3.05 bounds 2.47 (summed
        # over the lattice).
        stiffest=heaviest * factor * (1.0 + DENSEST * square),
        kinds=max(len(discs), 1),
        kind=pad_values(context.species) if discs else None,
        table=PairDragTable(made, shifts),
    )


def _pair_polynomials(plate: Plate, discs: tuple[Disc, ...]) -> np.ndarray | None:
    """Coefficients of each pair of kinds (k, k, 2, ORDER); None of dipoles over a thin plate."""
    if discs:
        return np.array(
            [[drag_tensor_polynomials(plate, (disc, other)) for other in discs] for disc in discs]
        )
    made = drag_tensor_polynomials(plate)
    return None if made is None else made[None, None]
