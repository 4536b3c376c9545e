"""The direct sum over all pairs: exact, each of the N(N-1)/2 pairs computed once.

Arrays are padded to the vector width with grains so far away that they add nothing
(`PADDING`). From `PARTED_FROM` grains on, the rows are dealt out to a fixed number of parts with
sums of their own, which are added in a fixed order: one thread or several give the same bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from granular.compiled import Array, compiled, threaded_if_wanted
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.direct_vector_loops import (
    WIDTH,
    pad_to_vectors,
    sum_pairs_within_block,
    sum_rows_with_partners,
)
from granular.pairs.grain_arrays import (
    GrainArrays,
    array_if_wanted,
    clear_array_if_given,
    clear_sums,
    replace_sums,
    scale_array_if_given,
    unscaled_force_factor,
    unscaled_sum_factor,
)
from granular.pairs.pure_python_sums import pure_python_direct_sum

if TYPE_CHECKING:
    from jaxtyping import Float

PADDING = 1e70
"""Place of the first padding grain [D]: r^5 overflows, so its force on a grain is exactly zero."""

# From here on a sum takes 0.2 ms, several times as long as threads need to start (50 us).
PARTED_FROM = 1024
# Fixed, so that the order of the sums does not depend on the number of threads.
PARTS = 8


def pad_coordinates(positions: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Split positions into padded arrays of x and y [D]; positions [D]."""
    count, size = len(positions), pad_to_vectors(len(positions))
    x, y = PADDING * np.arange(1.0, size + 1.0), np.zeros(size)
    x[:count], y[:count] = positions[:, 0], positions[:, 1]
    return x, y


def pad_values(values: np.ndarray) -> Float[np.ndarray, "m"]:
    """Pad one value a grain with zeros."""
    out = np.zeros(pad_to_vectors(len(values)))
    out[: len(values)] = values
    return out


def partial_sum_buffers(size: int) -> Float[np.ndarray, "PARTS 5 m"] | None:
    """Allocate the sums of the parts that a direct sum is split into; None below `PARTED_FROM`."""
    return np.zeros((PARTS, 5, size)) if size >= PARTED_FROM else None


@compiled
def _sum_pairs_of_part(arrays: GrainArrays, periodic_cut_off: Array | None, part: int, parts: int) -> None:
    size = arrays.x.size
    for first in range(part * WIDTH, size, parts * WIDTH):
        sum_pairs_within_block(arrays, first, periodic_cut_off)
        sum_rows_with_partners(arrays, first, first + WIDTH, size, periodic_cut_off)


@compiled
def _sum_part_into_buffer(
    arrays: GrainArrays, periodic_cut_off: Array | None, buffer: Array, part: int
) -> None:
    buffer[:4] = 0.0
    buffer[4, :2] = 0.0
    sums = replace_sums(
        arrays,
        buffer[0],
        buffer[1],
        array_if_wanted(arrays.stiffness, buffer[2]),
        array_if_wanted(arrays.energy_and_closest, buffer[4]),
        array_if_wanted(arrays.load, buffer[3]),
    )
    _sum_pairs_of_part(sums, periodic_cut_off, part, PARTS)


@threaded_if_wanted
def _sum_parts_into_buffers(arrays: GrainArrays, periodic_cut_off: Array | None, buffers: Array) -> None:
    for part in numba.prange(PARTS):
        _sum_part_into_buffer(arrays, periodic_cut_off, buffers[part], part)


@compiled
def _add_buffers(buffers: Array, row: int, out: Array | None) -> None:
    if out is not None:
        for i in range(out.size):
            total = buffers[0, row, i]
            for part in range(1, PARTS):
                total += buffers[part, row, i]
            out[i] = total


@compiled
def _combine_energy_and_closest(buffers: Array, energy_and_closest: Array | None) -> None:
    if energy_and_closest is not None:
        for part in range(PARTS):
            energy_and_closest[0] += buffers[part, 4, 0]
            energy_and_closest[1] = max(energy_and_closest[1], buffers[part, 4, 1])


@compiled
def _compiled_direct_sum(
    arrays: GrainArrays, buffers: Array | None, threaded: bool | None, periodic_cut_off: Array | None
) -> None:
    if buffers is None:
        clear_sums(arrays)
        _sum_pairs_of_part(arrays, periodic_cut_off, 0, 1)
    else:
        _sum_parts_into_buffers(threaded, arrays, periodic_cut_off, buffers)
        _add_buffers(buffers, 0, arrays.fx)
        _add_buffers(buffers, 1, arrays.fy)
        _add_buffers(buffers, 2, arrays.stiffness)
        _add_buffers(buffers, 3, arrays.load)
        clear_array_if_given(arrays.energy_and_closest)
        _combine_energy_and_closest(buffers, arrays.energy_and_closest)
    scale, strength = unscaled_sum_factor(arrays.series), STRENGTH * unscaled_force_factor(arrays.series)
    scale_array_if_given(arrays.fx, strength)
    scale_array_if_given(arrays.fy, strength)
    scale_array_if_given(arrays.stiffness, scale)
    scale_array_if_given(arrays.load, scale)
    scale_array_if_given(arrays.energy_and_closest, scale)


direct_sum = pure_python_direct_sum if numba.config.DISABLE_JIT else _compiled_direct_sum
"""Pair forces of all grains, and what else is asked for in the same pass.

Parameters
----------
arrays : GrainArrays
buffers : float64 (PARTS, 5, m) or None
    From `partial_sum_buffers`.
threaded : bool or None
    None runs the parts one after another, anything else on Numba's threads.
periodic_cut_off : float64 (3,) or None
    Of a periodic cell, where each grain meets the nearest image of every other one: its width and
    height, and the radius where pairs end [D], at most half the shorter side. The energy of a pair
    is taken as zero there.
"""
