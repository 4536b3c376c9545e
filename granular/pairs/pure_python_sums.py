"""Plain reference for `direct_sum` and `cut_off_sum`: a loop over pairs with the unmodified formulas.

The functions take the same arguments; with ``NUMBA_DISABLE_JIT=1`` they run without compilation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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
from granular.pairs.grain_arrays import COMMON, FAR, LOAD_FAR, LOAD_TERM, TERM, GrainArrays
from granular.shared.array_types import Float

PADDING = 1e60
"""Grains beyond this position are padding [D]."""


class _PairLawValues(NamedTuple):
    """Values that replace 1/r^5 in the force, 1/r^3 in energy and both loads, and 1/r^5 in the stiffness."""

    slope: float
    cube: float
    loads: tuple[float, float]
    fifth: float


def _pair_law_values(arrays: GrainArrays, i: int, j: int, r: float) -> _PairLawValues:
    if arrays.series is None:
        fifth = pair_force(r) / (STRENGTH * r)
        cube = pair_energy(r) / ENERGY
        return _PairLawValues(fifth, cube, (cube, cube), fifth)
    rho2 = r * r - sum(_squared_distance_shifts(arrays, i, j))
    fifth = np.abs(rho2) ** -2.5
    slope, cube = (1.0 + factor * arrays.series[TERM] * fifth for factor in (8.0 / 3.0, 1.0))
    cube *= rho2 * fifth
    shifts = _squared_distance_shifts(arrays, i, j)
    both = cube + (sum(shifts) + arrays.series[LOAD_TERM] * fifth) * fifth
    loads = both + 5.0 * shifts[0] * fifth, both + 5.0 * shifts[1] * fifth
    return _PairLawValues(slope * fifth, cube, loads, fifth)


def _squared_distance_shifts(arrays: GrainArrays, i: int, j: int) -> tuple[float, float]:
    """Return the contributions of grains ``i`` and ``j`` to the shift b = r^2 - rho^2 of discs."""
    assert arrays.series is not None
    if arrays.shift is None:
        return 0.5 * float(arrays.series[COMMON]), 0.5 * float(arrays.series[COMMON])
    return float(arrays.shift[i]), float(arrays.shift[j])


def _inverse_cube_at_cut_off(arrays: GrainArrays, i: int, j: int, radius: float) -> float:
    """Return the value at the cut-off of the quantity that replaces 1/r^3 in the energy."""
    rest = pair_energy(radius) / ENERGY
    if arrays.series is None:
        return rest
    b = sum(_squared_distance_shifts(arrays, i, j)) / radius**2
    return rest * (1.0 + b * (1.5 + 1.875 * b))


def pure_python_direct_sum(
    arrays: GrainArrays,
    buffers: Float[Array, "PARTS 5 m"] | None,
    threaded: bool | None,
    periodic_cut_off: Float[Array, "3"] | None,
) -> None:
    """Compute pair forces and the other sums, one pair at a time."""
    grains = int((~(arrays.x > PADDING)).sum())
    if periodic_cut_off is None:
        _sum_pairs(arrays, grains, math.inf, None, None)
    else:
        _sum_pairs(arrays, grains, periodic_cut_off[2], None, periodic_cut_off[:2])


def pure_python_cut_off_sum(
    stripes: object,
    radius: float,
    smooth: bool | None,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
) -> None:
    """Compute pair forces and the other sums within a radius; of ``stripes`` only the periods are used."""
    _sum_pairs(arrays, grains, radius, smooth, getattr(stripes, "periods", None))


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # for grains at equal positions
def _sum_pairs(
    arrays: GrainArrays, grains: int, radius: float, smooth: bool | None, periods: Array | None
) -> None:
    for out in (arrays.fx, arrays.fy, arrays.stiffness, arrays.energy_and_closest, arrays.load):
        if out is not None:
            out[:] = 0.0
    fifth, of_loads = (0.0 if arrays.series is None else float(arrays.series[k]) for k in (FAR, LOAD_FAR))
    for i in range(grains):
        for j in range(i + 1, grains):
            dx, dy = arrays.x[i] - arrays.x[j], arrays.y[i] - arrays.y[j]
            if periods is not None:
                dx -= periods[0] * np.rint(dx / periods[0])
                dy -= periods[1] * np.rint(dy / periods[1])
            r = np.sqrt(dx * dx + dy * dy)
            if r >= radius:
                continue
            law, square = _pair_law_values(arrays, i, j, r), np.array(r * r)
            rest = _inverse_cube_at_cut_off(arrays, i, j, radius)
            if smooth is not None:
                far = float(far_part_of_inverse_cube(square, radius, of_loads))
                law = law._replace(
                    slope=law.slope - float(far_part_of_inverse_fifth(square, radius, fifth)),
                    cube=law.cube - float(far_part_of_inverse_cube(square, radius, fifth)),
                    loads=(law.loads[0] - far, law.loads[1] - far),
                )
                rest -= float(far_part_of_inverse_cube(np.array(radius**2), radius, fifth))
            _add_pair_to_sums(arrays, (i, j), (dx, dy), law, rest)


def _add_pair_to_sums(
    arrays: GrainArrays, pair: tuple[int, int], apart: tuple[float, float], law: _PairLawValues, rest: float
) -> None:
    """Add a pair to all sums; ``rest`` is subtracted from the energy of the pair."""
    i, j = pair
    q = np.ones(arrays.x.size) if arrays.moments is None else arrays.moments
    ratio = q[i] * q[j] * STRENGTH * law.slope
    for position, sign in ((i, 1.0), (j, -1.0)):
        arrays.fx[position] += sign * ratio * apart[0]
        arrays.fy[position] += sign * ratio * apart[1]
    if arrays.stiffness is not None:
        arrays.stiffness[i] += q[j] * law.fifth
        arrays.stiffness[j] += q[i] * law.fifth
    if arrays.energy_and_closest is not None:
        arrays.energy_and_closest[0] += q[i] * q[j] * (law.cube - rest)
        r = np.hypot(*apart)
        arrays.energy_and_closest[1] = max(arrays.energy_and_closest[1], pair_force(r) / (STRENGTH * r))
    if arrays.load is not None and arrays.weight is not None:
        arrays.load[i] += arrays.weight[j] * law.loads[0]
        arrays.load[j] += arrays.weight[i] * law.loads[1]
