"""Pairs within a cut-off radius, at a cost linear in the number of grains.

Each grain is met with its partners in stripes, eight at a time and masked at the radius. The rows
are dealt out to parts that take about equally long, each with sums of its own, which are added in a
fixed order: one thread or several give the same bits.
"""

from __future__ import annotations

import numba
import numpy as np

from granular.compiled import Array, compiled, threaded_if_wanted
from granular.pairs.cut_off_vector_loops import sum_row_ranges
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.grain_arrays import (
    GrainArrays,
    array_if_wanted,
    replace_energy_and_closest,
    set_forces_to_nan,
    unscaled_force_factor,
    unscaled_sum_factor,
)
from granular.pairs.pure_python_sums import pure_python_cut_off_sum
from granular.pairs.stripe_partner_lists import refresh_partner_lists
from granular.pairs.stripes import Stripes


@compiled
def _load_positions_of_part(stripes: Stripes, requested: GrainArrays, part: int) -> None:
    """Put the grains of a part where they are now, and clear its sums."""
    for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
        stripes.x[stripes.slot[k]] = requested.x[stripes.order[k]]
        stripes.y[stripes.slot[k]] = requested.y[stripes.order[k]]
    _wrap_into_cell(stripes.cell_offsets, stripes, part)
    _clear_sums_if_wanted(requested.fx, stripes.fx, stripes, part)
    _clear_sums_if_wanted(requested.fy, stripes.fy, stripes, part)
    _clear_sums_if_wanted(requested.stiffness, stripes.stiffness, stripes, part)
    _clear_sums_if_wanted(requested.load, stripes.load, stripes, part)


@compiled(inline=True)
def _wrap_into_cell(cell_offsets: Array | None, stripes: Stripes, part: int) -> None:
    """In a periodic cell, replace the grains by their images within it."""
    if cell_offsets is not None:
        for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
            stripes.x[stripes.slot[k]] -= cell_offsets[0, stripes.order[k]]
            stripes.y[stripes.slot[k]] -= cell_offsets[1, stripes.order[k]]


@compiled(inline=True)
def _clear_sums_if_wanted(requested: Array | None, sums: Array | None, stripes: Stripes, part: int) -> None:
    if requested is not None and sums is not None:
        sums[part, stripes.lows[part] : stripes.ends[part]] = 0.0


@compiled
def _sum_pairs_of_part(
    stripes: Stripes, requested: GrainArrays, part: int, radius: float, smooth: bool | None
) -> None:
    """Meet the partners of a part's rows."""
    sums = GrainArrays(
        stripes.x,
        stripes.y,
        stripes.fx,
        stripes.fy,
        stripes.moments,
        array_if_wanted(requested.stiffness, stripes.stiffness),
        requested.energy_and_closest,
        array_if_wanted(requested.load, stripes.load),
        stripes.weight,
        requested.series,
        stripes.shift,
    )
    first, stop = stripes.rows[part], stripes.rows[part + 1]
    sum_row_ranges(sums, stripes.partner_ranges, part, first, stop, radius, smooth, stripes.shifts)


@compiled(inline=True)
def _add_sums_of_other_parts(sums: Array, stripes: Stripes, part: int) -> None:
    """Add to a part's sums what the other parts have for its rows."""
    for other in range(stripes.ends.size):
        first = max(stripes.lows[other], stripes.rows[part])
        end = min(stripes.ends[other], stripes.rows[part + 1])
        if other != part:
            total, more = sums[part, first:end], sums[other, first:end]
            for k in range(total.size):
                total[k] += more[k]


@compiled
def _copy_sums_if_wanted(
    out: Array | None, sums: Array | None, scale: float, stripes: Stripes, part: int
) -> None:
    """Give the grains of a part their sums, where they are asked for."""
    if out is not None and sums is not None:
        _add_sums_of_other_parts(sums, stripes, part)
        for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
            out[stripes.order[k]] = scale * sums[part, stripes.slot[k]]


@compiled
def _copy_all_sums_of_part(stripes: Stripes, requested: GrainArrays, part: int) -> None:
    scale, strength = (
        unscaled_sum_factor(requested.series),
        STRENGTH * unscaled_force_factor(requested.series),
    )
    _copy_sums_if_wanted(requested.fx, stripes.fx, strength, stripes, part)
    _copy_sums_if_wanted(requested.fy, stripes.fy, strength, stripes, part)
    _copy_sums_if_wanted(requested.stiffness, stripes.stiffness, scale, stripes, part)
    _copy_sums_if_wanted(requested.load, stripes.load, scale, stripes, part)


# A kernel each: Numba runs two loops as one where it sees nothing that the second takes from the
# first, and it does not look into the kernels that they call.


@threaded_if_wanted
def _load_positions(stripes: Stripes, requested: GrainArrays) -> None:
    for part in numba.prange(stripes.ends.size):
        _load_positions_of_part(stripes, requested, part)


@threaded_if_wanted
def _sum_pairs(stripes: Stripes, requested: GrainArrays, radius: float, smooth: bool | None) -> None:
    for part in numba.prange(stripes.ends.size):
        _sum_pairs_of_part(stripes, requested, part, radius, smooth)


@threaded_if_wanted
def _copy_sums(stripes: Stripes, requested: GrainArrays) -> None:
    for part in numba.prange(stripes.ends.size):
        _copy_all_sums_of_part(stripes, requested, part)


@compiled
def _sum_all_parts(
    threaded: bool | None, stripes: Stripes, requested: GrainArrays, radius: float, smooth: bool | None
) -> None:
    _load_positions(threaded, stripes, requested)
    _sum_pairs(threaded, stripes, requested, radius, smooth)
    _copy_sums(threaded, stripes, requested)


@compiled(inline=True)
def _sum_with_energy_and_closest(
    energy_and_closest: Array | None,
    threaded: bool | None,
    stripes: Stripes,
    arrays: GrainArrays,
    radius: float,
    smooth: bool | None,
) -> None:
    """Sum the pairs; extremes, where they are asked for, by a row for each part."""
    if energy_and_closest is None:
        _sum_all_parts(threaded, stripes, arrays, radius, smooth)
    else:
        parts = np.zeros((stripes.ends.size, 2))
        measured = replace_energy_and_closest(arrays, parts)
        _sum_all_parts(threaded, stripes, measured, radius, smooth)
        energy_and_closest[:] = 0.0
        scale = unscaled_sum_factor(arrays.series)
        for part in range(len(parts)):
            energy_and_closest[0] += scale * parts[part, 0]
            energy_and_closest[1] = max(energy_and_closest[1], scale * parts[part, 1])


@compiled
def _compiled_cut_off_sum(
    stripes: Stripes,
    radius: float,
    smooth: bool | None,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
) -> None:
    if refresh_partner_lists(stripes, arrays, grains, radius):
        _sum_with_energy_and_closest(arrays.energy_and_closest, threaded, stripes, arrays, radius, smooth)
    else:
        set_forces_to_nan(arrays, grains)


cut_off_sum = pure_python_cut_off_sum if numba.config.DISABLE_JIT else _compiled_cut_off_sum
"""Pair forces within a radius, and what else is asked for in the same pass.

Parameters
----------
stripes : Stripes
radius : float
    Cut-off radius [D]. The energy of a pair is taken as zero there.
smooth : bool or None
    None where pairs just end; else the far part of their law is taken off, for a far field.
threaded : bool or None
    None sweeps the stripes one after another, anything else on Numba's threads.
grains : int
arrays : GrainArrays
"""
