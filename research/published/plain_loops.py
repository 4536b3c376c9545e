"""De Paula's two methods of summing over pairs, written as simply as in the thesis, to measure their times.

One loop is over all pairs, the other over a list of neighbours. Both use one thread and no vector
instructions.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numba
import numpy as np

from granular.pairs.dipole_law import STRENGTH

REPEATS = 7


@numba.njit(cache=True)
def _sum_forces_over_all_pairs(x: np.ndarray, y: np.ndarray, force: np.ndarray) -> None:
    force[:] = 0.0
    for i in range(x.size):
        for j in range(i + 1, x.size):
            _add_pair_force(x, y, force, i, j)


@numba.njit(cache=True)
def _sum_forces_over_listed_pairs(
    x: np.ndarray, y: np.ndarray, force: np.ndarray, first: np.ndarray, others: np.ndarray
) -> None:
    force[:] = 0.0
    for i in range(x.size):
        for k in range(first[i], first[i + 1]):
            _add_pair_force(x, y, force, i, others[k])


@numba.njit(cache=True, inline="always")
def _add_pair_force(x: np.ndarray, y: np.ndarray, force: np.ndarray, i: int, j: int) -> None:
    dx, dy = x[i] - x[j], y[i] - y[j]
    r2 = dx * dx + dy * dy
    ratio = STRENGTH / (r2 * r2 * np.sqrt(r2))
    force[0, i] += ratio * dx
    force[1, i] += ratio * dy
    force[0, j] -= ratio * dx
    force[1, j] -= ratio * dy


def list_starts_and_neighbours_within_radius(
    positions: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the start of each grain's list (n + 1,), and the later grains within the radius."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(positions).query_pairs(radius, output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    first = np.searchsorted(pairs[:, 0], np.arange(len(positions) + 1))
    return first, np.ascontiguousarray(pairs[:, 1])


def measure_direct_and_list_sum_times(positions: np.ndarray, radius: float) -> tuple[float, float]:
    """Return the processor time [us] of one sum by either loop, minimum of repeats; positions (n, 2) [D]."""
    x, y = np.ascontiguousarray(positions[:, 0]), np.ascontiguousarray(positions[:, 1])
    force = np.zeros((2, len(x)))
    first, others = list_starts_and_neighbours_within_radius(positions, radius)
    _sum_forces_over_all_pairs(x, y, force)
    integer = force.copy()
    _sum_forces_over_listed_pairs(x, y, force, *list_starts_and_neighbours_within_radius(positions, np.inf))
    assert np.allclose(force, integer)
    return _measure_minimum_time(_sum_forces_over_all_pairs, x, y, force), _measure_minimum_time(
        _sum_forces_over_listed_pairs, x, y, force, first, others
    )


def _measure_minimum_time(loop: Callable[..., object], *arguments: np.ndarray) -> float:
    shortest, sums = np.inf, max(1, 40_000_000 // arguments[0].size ** 2)
    for _ in range(REPEATS):
        started = time.process_time()
        for _ in range(sums):
            loop(*arguments)
        shortest = min(shortest, (time.process_time() - started) / sums)
    return 1e6 * shortest
