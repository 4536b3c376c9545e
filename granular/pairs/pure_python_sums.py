"""The direct sum once more, as plain as the law is written: the slow twin of `direct_sum`.

Takes the same arguments; runs without compilation when ``NUMBA_DISABLE_JIT=1``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array
from granular.pairs.dipole_law import (
    ENERGY,
    STRENGTH,
    far_part_of_inverse_cube,
    far_part_of_inverse_fifth,
    pair_energy,
    pair_force,
)
from granular.pairs.grain_arrays import COMMON, FAR, TERM, GrainArrays

if TYPE_CHECKING:
    from jaxtyping import Float

PADDING = 1e60
"""Places of padding grains are beyond [D]; they have no images."""


class _PairLawValues(NamedTuple):
    """Stand-ins for 1/r^5 in the force and 1/r^3 in the energy of a pair, and the sum's 1/r^5."""

    slope: float
    cube: float
    fifth: float


def _pair_law_values(arrays: GrainArrays, i: int, j: int, r: float) -> _PairLawValues:
    if arrays.series is None:
        fifth = pair_force(r) / (STRENGTH * r)
        return _PairLawValues(fifth, pair_energy(r) / ENERGY, fifth)
    rho2 = r * r - _pair_squared_distance_shift(arrays, i, j)
    fifth = np.abs(rho2) ** -2.5
    slope, cube = (1.0 + factor * arrays.series[TERM] * fifth for factor in (8.0 / 3.0, 1.0))
    return _PairLawValues(slope * fifth, cube * rho2 * fifth, fifth)


def _pair_squared_distance_shift(arrays: GrainArrays, i: int, j: int) -> float:
    assert arrays.series is not None
    return float(arrays.series[COMMON] if arrays.shift is None else arrays.shift[i] + arrays.shift[j])


def _energy_at_cut_off(arrays: GrainArrays, i: int, j: int, radius: float) -> float:
    """Value that stands for 1/r^3 where pairs end."""
    rest = pair_energy(radius) / ENERGY
    if arrays.series is None:
        return rest
    b = _pair_squared_distance_shift(arrays, i, j) / radius**2
    return rest * (1.0 + b * (1.5 + 1.875 * b))


def pure_python_direct_sum(
    arrays: GrainArrays,
    buffers: Float[Array, "PARTS 5 m"] | None,
    threaded: bool | None,
    periodic_cut_off: Float[Array, "3"] | None,
) -> None:
    """Pair forces and sums of all grains, one pair at a time; arrays [D, F*], periodic_cut_off [D]."""
    _clear_all_sums(arrays)
    # The distance to padding grains overflows, as it should, and that of grains at one place is 0.
    old = np.seterr(over="ignore", divide="ignore", invalid="ignore")
    for i in range(arrays.x.size):
        for j in range(i + 1, arrays.x.size):
            dx, dy = arrays.x[i] - arrays.x[j], arrays.y[i] - arrays.y[j]
            rest = 0.0
            if periodic_cut_off is not None and max(arrays.x[i], arrays.x[j]) < PADDING:
                dx -= periodic_cut_off[0] * np.rint(dx / periodic_cut_off[0])
                dy -= periodic_cut_off[1] * np.rint(dy / periodic_cut_off[1])
            r = np.sqrt(dx * dx + dy * dy)
            if periodic_cut_off is not None:
                if r >= periodic_cut_off[2]:
                    continue
                rest = _energy_at_cut_off(arrays, i, j, periodic_cut_off[2])
            law = _pair_law_values(arrays, i, j, r)
            _add_pair_to_sums(arrays, (i, j), (dx, dy), law.fifth, law.slope, law.cube, rest)
    np.seterr(**old)


def pure_python_cut_off_sum(
    stripes: object,
    radius: float,
    smooth: bool | None,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
) -> None:
    """Pair forces [F*] and sums within a radius [D], at which the energy is zero; of stripes only periods."""
    _clear_all_sums(arrays)
    periods = getattr(stripes, "periods", None)
    fifth = 0.0 if arrays.series is None else float(arrays.series[FAR])
    for i in range(grains):
        for j in range(i + 1, grains):
            dx, dy = arrays.x[i] - arrays.x[j], arrays.y[i] - arrays.y[j]
            if periods is not None:
                dx -= periods[0] * np.rint(dx / periods[0])
                dy -= periods[1] * np.rint(dy / periods[1])
            r = np.sqrt(dx * dx + dy * dy)
            if r < radius:
                law, square = _pair_law_values(arrays, i, j, r), np.array(r * r)
                slope, cube, rest = law.slope, law.cube, _energy_at_cut_off(arrays, i, j, radius)
                if smooth is not None:
                    slope -= float(far_part_of_inverse_fifth(square, radius, fifth))
                    cube -= float(far_part_of_inverse_cube(square, radius, fifth))
                    rest -= float(far_part_of_inverse_cube(np.array(radius**2), radius, fifth))
                _add_pair_to_sums(arrays, (i, j), (dx, dy), law.fifth, slope, cube, rest)


def _clear_all_sums(arrays: GrainArrays) -> None:
    for out in (arrays.fx, arrays.fy, arrays.stiffness, arrays.energy_and_closest, arrays.load):
        if out is not None:
            out[:] = 0.0


def _add_pair_to_sums(
    arrays: GrainArrays,
    pair: tuple[int, int],
    apart: tuple[float, float],
    fifth: float,
    slope: float,
    cube: float,
    rest: float,
) -> None:
    """Add a pair to all sums, with what stands for 1/r^5 and 1/r^3; energies are less by a rest."""
    i, j = pair
    q = np.ones(arrays.x.size) if arrays.moments is None else arrays.moments
    ratio = q[i] * q[j] * STRENGTH * slope
    for position, sign in ((i, 1.0), (j, -1.0)):
        arrays.fx[position] += sign * ratio * apart[0]
        arrays.fy[position] += sign * ratio * apart[1]
    if arrays.stiffness is not None:
        arrays.stiffness[i] += q[j] * fifth
        arrays.stiffness[j] += q[i] * fifth
    if arrays.energy_and_closest is not None:
        arrays.energy_and_closest[0] += q[i] * q[j] * (cube - rest)
        r = np.hypot(*apart)
        arrays.energy_and_closest[1] = max(arrays.energy_and_closest[1], pair_force(r) / (STRENGTH * r))
    if arrays.load is not None and arrays.weight is not None:
        arrays.load[i] += arrays.weight[j] * cube
        arrays.load[j] += arrays.weight[i] * cube
