"""The direct sum over all pairs: exact, each of the N(N-1)/2 pairs computed once.

Arrays are padded to the vector width with grains so far away that they add nothing
(`PADDING`). From `PARTED_FROM` grains on, the rows are dealt out to a fixed number of parts with
sums of their own, which are added in a fixed order: one thread or several give the same bits.
"""

from __future__ import annotations

import numba
import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.dipole import STRENGTH
from granular.pairs.lanes import SCALE
from granular.pairs.plain import plain_direct_sum
from granular.pairs.vector import WIDTH, pad_to_vectors, sweep_block, sweep_rows

PADDING = 1e70
"""Place of the first padding grain [D]: r^5 overflows, so its force on a grain is exactly zero."""

PARTED_FROM = 1024
PARTS = 8


def padded_coordinates(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) as two padded arrays."""
    count, size = len(positions), pad_to_vectors(len(positions))
    x, y = PADDING * np.arange(1.0, size + 1.0), np.zeros(size)
    x[:count], y[:count] = positions[:, 0], positions[:, 1]
    return x, y


def padded_values(values: np.ndarray) -> np.ndarray:
    """One value a grain, padded with zeros."""
    out = np.zeros(pad_to_vectors(len(values)))
    out[: len(values)] = values
    return out


def part_buffers(size: int) -> np.ndarray | None:
    """Buffers of the parts' own sums; None for so few grains that they are summed in one part."""
    return np.zeros((PARTS, 5, size)) if size >= PARTED_FROM else None


@compiled
def _sweep(
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    moments: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    nearest: Array | None,
    part: int,
    parts: int,
) -> None:
    size = x.size
    for first in range(part * WIDTH, size, parts * WIDTH):
        sweep_block(x, y, fx, fy, moments, stiffness, extremes, load, weight, first, nearest)
        sweep_rows(
            x, y, fx, fy, moments, stiffness, extremes, load, weight, first, first + WIDTH, size,
            nearest,
        )  # fmt: skip


@compiled
def _sweep_part(
    x: Array,
    y: Array,
    moments: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    nearest: Array | None,
    buffer: Array,
    part: int,
) -> None:
    buffer[0] = 0.0
    buffer[1] = 0.0
    if stiffness is not None:
        stiffness = buffer[2]
        stiffness[:] = 0.0
    if extremes is not None:
        extremes = buffer[4]
        extremes[:2] = 0.0
    if load is not None:
        load = buffer[3]
        load[:] = 0.0
    _sweep(
        x, y, buffer[0], buffer[1], moments, stiffness, extremes, load, weight, nearest, part, PARTS
    )


@compiled
def _sweep_parts(
    x: Array,
    y: Array,
    moments: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    nearest: Array | None,
    buffers: Array,
) -> None:
    for part in range(PARTS):
        _sweep_part(x, y, moments, stiffness, extremes, load, weight, nearest, buffers[part], part)


@compiled(parallel=True)
def _sweep_parts_threaded(
    x: Array,
    y: Array,
    moments: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    nearest: Array | None,
    buffers: Array,
) -> None:
    for part in numba.prange(PARTS):
        _sweep_part(x, y, moments, stiffness, extremes, load, weight, nearest, buffers[part], part)


@compiled
def _add_parts(buffers: Array, row: int, out: Array) -> None:
    for i in range(out.size):
        total = buffers[0, row, i]
        for part in range(1, PARTS):
            total += buffers[part, row, i]
        out[i] = total


@compiled
def _direct_sum(
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    moments: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    buffers: Array | None,
    threaded: bool | None,
    nearest: Array | None,
) -> None:
    if extremes is not None:
        extremes[:] = 0.0
    if buffers is None:
        fx[:] = 0.0
        fy[:] = 0.0
        if stiffness is not None:
            stiffness[:] = 0.0
        if load is not None:
            load[:] = 0.0
        _sweep(x, y, fx, fy, moments, stiffness, extremes, load, weight, nearest, 0, 1)
    else:
        if threaded is None:
            _sweep_parts(x, y, moments, stiffness, extremes, load, weight, nearest, buffers)
        else:
            _sweep_parts_threaded(
                x, y, moments, stiffness, extremes, load, weight, nearest, buffers
            )
        _add_parts(buffers, 0, fx)
        _add_parts(buffers, 1, fy)
        if stiffness is not None:
            _add_parts(buffers, 2, stiffness)
        if load is not None:
            _add_parts(buffers, 3, load)
        if extremes is not None:
            for part in range(PARTS):
                extremes[0] += buffers[part, 4, 0]
                extremes[1] = max(extremes[1], buffers[part, 4, 1])
    for i in range(fx.size):
        fx[i] *= STRENGTH * SCALE
        fy[i] *= STRENGTH * SCALE
    if stiffness is not None:
        stiffness *= SCALE
    if load is not None:
        load *= SCALE
    if extremes is not None:
        extremes *= SCALE


direct_sum = plain_direct_sum if numba.config.DISABLE_JIT else _direct_sum
"""Pair forces of all grains, and what else is asked for in the same pass.

Parameters
----------
x, y : float64 (m,)
    Positions [D], padded.
fx, fy : float64 (m,)
    Overwritten by the forces [F*].
moments : float64 (m,) or None
    Moment of each grain over the first species'; None where all are alike.
stiffness : float64 (m,) or None
    Overwritten by sum_j q_j / r^5.
extremes : float64 (2,) or None
    Overwritten by the sum over pairs of q_i q_j / r^3 and by the largest 1 / r^5.
load, weight : float64 (m,) or None
    ``load`` is overwritten by sum_j weight_j / r^3.
buffers : float64 (PARTS, 5, m) or None
    From `part_buffers`.
threaded : bool or None
    None runs the parts one after another, anything else on Numba's threads.
nearest : float64 (3,) or None
    Of a periodic cell, where each grain meets the nearest image of every other one: its width and
    height, and the radius where pairs end [D], at most half the shorter side. The energy of a pair
    is taken as zero there.
"""
