"""Eddy-current drag, including the currents that all other grains induce.

At low speed the currents in each layer of the plate follow the field of the magnets without delay, and each
magnet is subject to the currents that all magnets induce. The force on magnet i is -sum_j T_ij v_j, with a
tensor that depends on the displacement between the magnets i and j:

    T_ij = (gamma H^4/3) Int_0^inf k^3 w(k) [J1(kr)/(kr) - J2(kr) e e^T] dk,   H = 2h,

where gamma is the drag coefficient of a lone dipole over a thin plate, r e is the displacement with the unit
vector e, and w(k) is the mean of exp(-2kz) over the distances z in the plate. One factor exp(-kz) is due to
the field of the magnet, the other to the reaction of the currents. Since T is the Fourier transform of k k^T
w(k) >= 0, T is positive and drag never adds energy. For a thin plate, w = exp(-kH) and

    T_ij = gamma (H^2/s)^(5/2) [1 - 5 r r^T/s],   s = r^2 + H^2,

which corresponds to two receding images [Maxwell 1872; Reitz 1970, doi:10.1063/1.1659172].

At fixed positions the velocities obey m_i dv_i/dt = -sum_j q_i q_j T_ij v_j, with moments q relative to the
first species. With A = dt M^(-1) T, where M contains the masses and T includes q_i q_j, v after a step is
v - A v + A^2 v/2. This is of second order in ``dt``, and the energy cannot increase if all eigenvalues of A
are below 2; longer steps are subdivided. The recorded loss is exactly the loss of kinetic energy.

In a large bed the sum is over pairs within a cut-off distance, from a list of near pairs. To ensure that the
truncated sum does not add energy, each grain then has an additional drag equal to an upper bound of the
neglected terms. In a periodic cell the list contains the images; images beyond the cut-off are replaced by a
uniform density of magnets that move with the mean velocity.

The tensors are computed once for all matrix products at the same positions, and stored. For dipoles over a
thin plate without a cut-off, the tensors are computed in each product, which is as fast as storing them.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev

from granular.compiled import Array, compiled
from granular.effects.effect import EffectContext
from granular.kernel_data.state import LOSSES, Bed, relative_moments
from granular.pairs.direct_sum import pad_values
from granular.pairs.disc_law import Disc
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.near_law import (
    partner_at_list_entry,
    partner_index_range,
    periodic_shifts_of_list,
    try_to_refresh_near_list,
)
from granular.pairs.near_list import NearList, allocate_near_list, pair_displacement
from granular.pairs.piecewise import (
    PiecewiseTable,
    Samples,
    find_piece_index,
    force_over_distance_in_piece,
    tabulate_values,
)
from granular.shared.array_types import Float, Int

# 1e-13 holds if the face of a thick plate is >= 0.17 D from the grains' mid-plane; 4e-8 at 0.1 D.
ORDER = 64
"""Number of coefficients of each series for the drag tensor; the error is 1e-13 of a lone grain's drag."""

FARTHEST = 30.0
"""Distance [D] up to which the series is fitted; also the cut-off in a periodic cell. The relative drag of a
grain farther away is below 1e-5."""

# A cosine over this phase is integrated to 1e-14; over a phase of 40, to 3e-13.
_PANEL = 20.0
"""Interval of the phase k r [rad] in which 24 Gauss nodes integrate Bessel functions to rounding error."""


class Plate(NamedTuple):
    """Position and thickness of a conducting plate parallel to the grains' plane."""

    distance: float  # [D], from the grains' mid-plane to the plate's
    thickness: float  # [D]; 0: a thin plate

    def thickness_drag_factor(self) -> float:
        """Ratio of a lone dipole's drag over this plate to its drag over an equally conducting thin plate."""
        h, half = self.distance, 0.5 * self.thickness
        if half == 0.0:
            return 1.0
        return h**4 * ((h - half) ** -3 - (h + half) ** -3) / (6.0 * half)


def isotropic_and_radial_drag_tensor(
    plate: Plate, r: Float[np.ndarray, "n"], discs: tuple[Disc, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the isotropic and radial parts (n,) of T in units of a lone dipole's thin-plate drag; r [D]."""
    from scipy.special import j0, j1

    h, half = plate.distance, 0.5 * plate.thickness
    # exp(-45) = 3e-20: the rest of the integral is below rounding.
    longest = 45.0 / (2.0 * (h - half) - 0.5 * sum(disc.height for disc in discs))
    panels = 8 + math.ceil(longest * float(np.max(r, initial=1.0)) / _PANEL)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    width = longest / panels
    k = (width * (np.arange(panels)[:, None] + 0.5 * (nodes + 1.0))).ravel()
    density = np.exp(-2.0 * k * h) * (np.sinh(2.0 * k * half) / (2.0 * k * half) if half else 1.0)
    density *= np.tile(0.5 * width * weights, panels) * (2.0 * h) ** 4 / 3.0 * k**3
    for disc in discs:
        across, along = k * disc.radius, 0.5 * k * disc.height
        density *= 2.0 * j1(across) / across * np.sinh(along) / along
    isotropic, radial = np.empty((2, len(r)))
    for index, distance in enumerate(r):
        phase = k * distance
        first = np.where(phase > 1e-6, j1(phase) / np.maximum(phase, 1e-6), 0.5)
        # Below 1e-3, J2 = 2 J1/x - J0 cancels; its series x^2/8 is accurate to 1e-7.
        second = np.where(phase > 1e-3, 2.0 * first - j0(phase), phase * phase / 8.0)
        isotropic[index], radial[index] = density @ first, -(density @ second)
    return isotropic, radial


@cache
def lone_disc_drag_factor(plate: Plate, disc: Disc) -> float:
    """Ratio of a lone disc's drag to the drag of a dipole over a thin plate."""
    return float(isotropic_and_radial_drag_tensor(plate, np.zeros(1), (disc, disc))[0][0])


@cache
def _fit_drag_tensor_series(plate: Plate, discs: tuple[Disc, ...]) -> tuple[Chebyshev, Chebyshev]:
    """Fit the series P and Q in T = u^(5/2) [P(u) - 5 Q(u) r r^T/s] for u = H^2/s."""
    square = 4.0 * plate.distance**2
    smallest = square / (square + FARTHEST**2)
    u = smallest + (1.0 - smallest) * 0.5 * (np.polynomial.chebyshev.chebpts1(ORDER) + 1.0)
    r = np.sqrt(square / u - square)
    isotropic, radial = isotropic_and_radial_drag_tensor(plate, r, discs)
    across, along = isotropic / u**2.5, -radial * square / (5.0 * r * r * u**3.5)
    domain = [smallest, 1.0]
    return Chebyshev.fit(u, across, ORDER - 1, domain), Chebyshev.fit(u, along, ORDER - 1, domain)


def isotropic_and_radial_drag_tensor_of_squares(
    plate: Plate, squares: Float[np.ndarray, "n"], discs: tuple[Disc, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the isotropic part (n,) of T, and the radial part over r^2 [1/D^2], at given r^2 [D^2]."""
    square = 4.0 * plate.distance**2
    u = square / (square + squares)
    p, q = np.ones_like(u), np.ones_like(u)
    if plate.thickness > 0.0 or discs:
        p, q = (series(u) for series in _fit_drag_tensor_series(plate, discs))
    return u**2.5 * p, -5.0 / square * u**3.5 * q


@cache
def lattice_drag_factor(plate: Plate, spacing: float) -> float:
    """Ratio of the drag per grain in a rigidly moving triangular lattice to the drag of a lone grain."""
    # The truncated sum, about pi rho H^5/R^3, is 1e-4 for the packaged damper's spacing and H = 4/3 D.
    reach = 40
    i, j = np.meshgrid(np.arange(-2 * reach, 2 * reach + 1), np.arange(-reach, reach + 1))
    r = spacing * np.hypot(i + 0.5 * j, math.sqrt(0.75) * j).ravel()
    r = r[r < reach * spacing * math.sqrt(0.75)]
    across, along = isotropic_and_radial_drag_tensor_of_squares(plate, r * r)
    # The mean of e e^T over directions is 1/2.
    return float((across + 0.5 * r * r * along).sum()) / plate.thickness_drag_factor()


NEGLECTED_DRAG = 0.01
"""Upper bound of the drag due to grains beyond the cut-off, divided by a lone dipole's drag."""

PAIRS_PER_LISTED = 2.5
"""A list of near pairs is faster if all pairs outnumber the pairs within the cut-off by this factor."""

CLOSEST, END = 2.0**-10, 2.0**20
"""Range of squared distances [D^2] in which T is tabulated; beyond this range T is below 1e-13."""

# 2/sqrt(3), and this number divided by 1.375^2 (see `granular.effects.eddy_drag.SPACING`).
DENSEST, USUAL = 1.155, 0.61
"""Grains per D^2 in a lattice of touching grains, and in a lattice with the packaged damper's spacing."""

# The error of 1 - A + A^2/2 is 0.019 at 0.5; a step would gain energy from 2 on.
LARGEST_EIGENVALUE = 0.5
"""Maximum eigenvalue of A = dt M^(-1) T in a step; the error of exp(-A) is then 2 %."""

PX, PY, INPUT_X, INPUT_Y, OUTPUT_X, OUTPUT_Y, FIRST_X, FIRST_Y = range(8)
"""Rows of the workspace: positions of the stored tensors, input and output of a product, and the first-order
term of the step."""


class PairDragTable(NamedTuple):
    """Drag of a grain due to its own currents, and tables of the drag tensor for each pair of species."""

    own: Float[np.ndarray, "k"]  # including the additional drag for grains beyond the cut-off
    parts: PiecewiseTable | None  # isotropic and radial part of each pair in turn; None: thin plate, dipoles


class EddyWorkspace(NamedTuple):
    """Scratch arrays of the pair sums."""

    rows: Float[np.ndarray, "8 m"]  # indices `PX` to `FIRST_Y` [D, D/tau]
    counted: Int[np.ndarray, "1"]  # number of grains with stored positions
    near: NearList | None  # None: all pairs count
    tensors: Float[np.ndarray, "3 p"] | None  # xx, xy and yy of each pair; None: computed at each product


class MutualEddyLaw(NamedTuple):
    """Eddy-current drag of all grains in natural units, for the compiled loop."""

    rate: float  # [1/tau], of a lone dipole of the first species over a thin plate
    square: float  # H^2 [D^2]
    reach: float  # cut-off distance [D]
    periods: tuple[float, float] | None  # side lengths of a periodic cell [D]
    mean: float  # coefficient of each grain's velocity in the drag due to images beyond the cut-off
    eigenvalue_bound: float  # upper bound of the eigenvalues of M^-1 T, divided by ``rate``
    kind_count: int  # 1 for dipoles; number of species for discs
    kind: Float[Array, "m"] | None  # kind of each grain; None if there is only one
    table: PairDragTable

    def workspace(self, size: int, count: int) -> EddyWorkspace:
        """Make the scratch arrays of the pair sums."""
        near, pairs = None, count * (count - 1) // 2
        if math.isfinite(self.reach):
            near = allocate_near_list(count, self.reach, periods=self.periods)
            pairs = near.partners.size
        kept_tensors = near is not None or self.table.parts is not None
        tensors = np.empty((3, pairs)) if kept_tensors else None
        return EddyWorkspace(np.zeros((8, size)), np.array([-1]), near, tensors)

    @staticmethod
    @compiled
    def damp_velocities(
        law: MutualEddyLaw, workspace: EddyWorkspace, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Damp the velocities by the eddy currents; record the lost energy; dt [tau]."""
        state, constants, rows = bed.state, bed.constants, workspace.rows
        masses, moments, count, lost = constants.masses, relative_moments(constants), constants.grains, 0.0
        near, tensors = workspace.near, workspace.tensors
        _refresh_pair_tensors(law, near, tensors, workspace, bed)
        steps = 1 + int(law.rate * law.eigenvalue_bound * abs(dt) / LARGEST_EIGENVALUE)
        h = law.rate * dt / steps
        for _ in range(steps):
            for i in range(count):
                charge = value_or_one(moments, i)
                rows[INPUT_X, i], rows[INPUT_Y, i] = charge * state.vx[i], charge * state.vy[i]
            _multiply_by_drag_tensor(law, near, tensors, rows, count)
            for i in range(count):
                charge = value_or_one(moments, i)
                factor = h * charge / value_or_one(masses, i)
                rows[FIRST_X, i], rows[FIRST_Y, i] = factor * rows[OUTPUT_X, i], factor * rows[OUTPUT_Y, i]
                rows[INPUT_X, i], rows[INPUT_Y, i] = charge * rows[FIRST_X, i], charge * rows[FIRST_Y, i]
            _multiply_by_drag_tensor(law, near, tensors, rows, count)
            for i in range(count):
                mass = value_or_one(masses, i)
                half = 0.5 * h * value_or_one(moments, i) / mass
                x = half * rows[OUTPUT_X, i] - rows[FIRST_X, i]
                y = half * rows[OUTPUT_Y, i] - rows[FIRST_Y, i]
                vx, vy = state.vx[i], state.vy[i]
                lost -= 0.5 * mass * (x * (2.0 * vx + x) + y * (2.0 * vy + y))
                state.vx[i], state.vy[i] = vx + x, vy + y
        state.ledger[LOSSES + index] += lost
        return 0


@compiled(inline=True)
def _kind_index_of_grain(kinds: Array | None, grain: int) -> int:
    return 0 if kinds is None else int(kinds[grain])


@compiled(inline=True)
def _isotropic_and_radial_part(
    parts: PiecewiseTable | None, row: int, r2: float, square: float
) -> tuple[float, float]:
    """Return the isotropic part of the tensor, and its radial part divided by r^2."""
    if parts is None:
        u = square / (r2 + square)
        power = u * u * math.sqrt(u)
        return power, -5.0 / square * u * power
    r2 = min(r2, END)
    # No piece is halved, so both parts have the same pieces.
    k = find_piece_index(parts, 2 * row, r2)
    return force_over_distance_in_piece(parts, k, r2), force_over_distance_in_piece(
        parts, k + np.uint64(parts.length), r2
    )


@compiled
def _refresh_pair_tensors(
    law: MutualEddyLaw, near: NearList | None, tensors: Array | None, workspace: EddyWorkspace, bed: Bed
) -> None:
    """If positions have changed, store them and the tensor of each pair."""
    x, y, count, moved = workspace.rows[PX], workspace.rows[PY], bed.constants.grains, 0
    for i in range(count):
        moved += not (x[i] == bed.state.x[i] and y[i] == bed.state.y[i])
        x[i], y[i] = bed.state.x[i], bed.state.y[i]
    if tensors is None or (moved == 0 and workspace.counted[0] == count):
        return
    workspace.counted[0] = count
    if not try_to_refresh_near_list(near, x, y, count):
        tensors[:] = np.nan  # stops the run
        return
    at = 0
    for i in range(count):
        first_row = _kind_index_of_grain(law.kind, i) * law.kind_count
        begin, end = partner_index_range(near, i, count)
        for k in range(begin, end):
            j = partner_at_list_entry(near, k)
            dx, dy = pair_displacement(periodic_shifts_of_list(near), k, x[i] - x[j], y[i] - y[j])
            r2 = dx * dx + dy * dy
            row = first_row + _kind_index_of_grain(law.kind, j)
            across, along = _isotropic_and_radial_part(law.table.parts, row, r2, law.square)
            # Further pairs, in the list's skin, depend on when the list was made.
            if r2 >= law.reach * law.reach:
                across, along = 0.0, 0.0
            tensors[0, at] = across + along * dx * dx
            tensors[1, at] = along * dx * dy
            tensors[2, at] = across + along * dy * dy
            at += 1


@compiled
def _multiply_by_drag_tensor(
    law: MutualEddyLaw, near: NearList | None, tensors: Array | None, rows: Array, count: int
) -> None:
    """Multiply the input rows of the workspace by T; write the result to the output rows."""
    vx, vy, sum_x, sum_y = rows[INPUT_X], rows[INPUT_Y], rows[OUTPUT_X], rows[OUTPUT_Y]
    total_x, total_y = 0.0, 0.0
    for i in range(count):
        total_x += vx[i]
        total_y += vy[i]
    for i in range(count):
        own = law.table.own[_kind_index_of_grain(law.kind, i)]
        sum_x[i], sum_y[i] = own * vx[i] + law.mean * total_x, own * vy[i] + law.mean * total_y
    if tensors is None:
        for j in range(count):
            _add_drag_by_motion_of_dipole(
                rows[PX, :count], rows[PY, :count], sum_x, sum_y, rows[:, j], law.square
            )
        return
    at = 0
    for i in range(count):
        total_x, total_y, vx_i, vy_i = 0.0, 0.0, vx[i], vy[i]
        begin, end = partner_index_range(near, i, count)
        for k in range(begin, end):
            j = partner_at_list_entry(near, k)
            xx, xy, yy = tensors[0, at], tensors[1, at], tensors[2, at]
            total_x += xx * vx[j] + xy * vy[j]
            total_y += xy * vx[j] + yy * vy[j]
            sum_x[j] += xx * vx_i + xy * vy_i
            sum_y[j] += xy * vx_i + yy * vy_i
            at += 1
        sum_x[i] += total_x
        sum_y[i] += total_y


@compiled
def _add_drag_by_motion_of_dipole(
    x: Array, y: Array, sum_x: Array, sum_y: Array, moving: Array, square: float
) -> None:
    """Add the drag on all dipoles over a thin plate due to the motion of one of them, including this one."""
    at_x, at_y, vx, vy = moving[PX], moving[PY], moving[INPUT_X], moving[INPUT_Y]
    for i in range(len(x)):
        dx, dy = x[i] - at_x, y[i] - at_y
        across, along = _isotropic_and_radial_part(None, 0, dx * dx + dy * dy, square)
        along *= dx * vx + dy * vy
        sum_x[i] += across * vx + along * dx
        sum_y[i] += across * vy + along * dy


def make_mutual_eddy_law(
    rate: float, plate: Plate, discs: tuple[Disc, ...], context: EffectContext
) -> MutualEddyLaw:
    """Make the drag law with the currents of all grains; ``rate`` is a lone grain's decay rate [1/tau]."""
    count, periods = context.grains.count, context.periods
    square = 4.0 * plate.distance**2
    mean, spare = 0.0, 0.0
    if periods is not None:
        reach = FARTHEST
        # The mean over directions is T ~ -(3/2) H^5/r^5; its sum beyond R is pi rho H^5/R^3.
        mean = -math.pi * square**2.5 / (reach**3 * periods[0] * periods[1])
    else:
        # At large distances |T| ~ 4 H^5/r^5; its sum beyond R is (8 pi/3) rho H^5/R^3.
        reach = (8.0 / 3.0 * math.pi * USUAL * square**2.5 / NEGLECTED_DRAG) ** (1.0 / 3.0)
        spare = NEGLECTED_DRAG
        if count < PAIRS_PER_LISTED * math.pi * USUAL * reach**2:
            reach, spare = math.inf, 0.0
    thin = plate.thickness == 0.0 and not discs
    pairs: list[tuple[Disc, ...]] = [(disc, other) for disc in discs for other in discs] or [()]
    # Without a tolerance no piece is halved, which `_isotropic_and_radial_part` relies on.
    parts = [partial(_tensor_part_and_magnitude, plate, two, part) for two in pairs for part in (0, 1)]
    equal_pairs = pairs[:: len(discs) + 1]
    self_drag = [
        isotropic_and_radial_drag_tensor_of_squares(plate, np.zeros(1), pair)[0][0] + spare
        for pair in equal_pairs
    ]
    # Products that are computed instead of stored include the self term of a dipole.
    own = np.zeros(1) if thin and math.isinf(reach) else np.array(self_drag)
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
        periods=periods,
        mean=mean,
        # 1 for grains far apart, rho H^2 for dense beds. At contact with H = 4/3 D the bound is 3.05, the
        # lattice sum 2.47.
        eigenvalue_bound=heaviest * factor * (1.0 + DENSEST * square),
        kind_count=len(equal_pairs),
        kind=pad_values(context.species) if discs else None,
        table=PairDragTable(own, None if thin else tabulate_values(parts, CLOSEST, END, math.inf)),
    )


def _tensor_part_and_magnitude(
    plate: Plate, discs: tuple[Disc, ...], part: int, squares: Samples
) -> tuple[Samples, Samples]:
    values = isotropic_and_radial_drag_tensor_of_squares(plate, squares, discs)[part]
    return values, np.ones_like(values)
