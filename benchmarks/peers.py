"""Straightforward pair sums: a plain numba loop, plain JAX, and a plain Verlet list."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

_plain = numba.njit(error_model="numpy", nogil=True)


@_plain
def plain_loop(x: np.ndarray, y: np.ndarray, fx: np.ndarray, fy: np.ndarray, count: int) -> None:
    """Compute the forces [F*] of all pairs."""
    fx[:] = 0.0
    fy[:] = 0.0
    for i in range(count):
        for j in range(i + 1, count):
            dx, dy = x[i] - x[j], y[i] - y[j]
            r2 = dx * dx + dy * dy
            s = 0.75 / (r2 * r2 * math.sqrt(r2))
            fx[i] += s * dx
            fy[i] += s * dy
            fx[j] -= s * dx
            fy[j] -= s * dy


@_plain
def plain_loop_with_load(
    x: np.ndarray,
    y: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    load: np.ndarray,
    weight: np.ndarray,
    count: int,
) -> None:
    """Compute the forces [F*] and friction loads of all pairs."""
    fx[:] = 0.0
    fy[:] = 0.0
    load[:] = 0.0
    for i in range(count):
        for j in range(i + 1, count):
            dx, dy = x[i] - x[j], y[i] - y[j]
            r2 = dx * dx + dy * dy
            fifth = 1.0 / (r2 * r2 * math.sqrt(r2))
            s, cube = 0.75 * fifth, r2 * fifth
            fx[i] += s * dx
            fy[i] += s * dy
            fx[j] -= s * dx
            fy[j] -= s * dy
            load[i] += weight[j] * cube
            load[j] += weight[i] * cube


class PlainVerletList(NamedTuple):
    """Partners j > i of every grain i, within radius and skin when the list was built.

    Attributes
    ----------
    begins : int64 (n + 1,)
    partner : int32 (p,)
    built : float64 (2, n)
        Positions when the list was built; NaN before.
    """

    begins: np.ndarray
    partner: np.ndarray
    built: np.ndarray


def verlet_list_workspace(count: int, partners: int) -> PlainVerletList:
    """Return the workspace for a mean number of partners per grain."""
    return PlainVerletList(
        np.zeros(count + 1, dtype=np.int64),
        np.zeros(max(1, count * partners), dtype=np.int32),
        np.full((2, count), np.nan),
    )


@_plain
def _fill(known: PlainVerletList, x: np.ndarray, y: np.ndarray, count: int, reach: float) -> None:
    """List partners, found with a grid of cells as wide as the reach."""
    left, low = x[:count].min(), y[:count].min()
    columns = int((x[:count].max() - left) / reach) + 1
    rows = int((y[:count].max() - low) / reach) + 1
    head = np.full(columns * rows, -1, dtype=np.int64)
    following = np.empty(count, dtype=np.int64)
    for i in range(count):
        cell = int((y[i] - low) / reach) * columns + int((x[i] - left) / reach)
        following[i] = head[cell]
        head[cell] = i
    filled = 0
    for i in range(count):
        known.begins[i] = filled
        column, row = int((x[i] - left) / reach), int((y[i] - low) / reach)
        for other_row in range(max(row - 1, 0), min(row + 2, rows)):
            for other_column in range(max(column - 1, 0), min(column + 2, columns)):
                j = head[other_row * columns + other_column]
                while j >= 0:
                    if j > i:
                        dx, dy = x[i] - x[j], y[i] - y[j]
                        if dx * dx + dy * dy < reach * reach:
                            if filled == known.partner.size:
                                raise ValueError("the list is full; give more partners per grain")
                            known.partner[filled] = j
                            filled += 1
                    j = following[j]
        known.built[0, i] = x[i]
        known.built[1, i] = y[i]
    known.begins[count] = filled


@_plain
def plain_verlet_list(
    known: PlainVerletList,
    radius: float,
    skin: float,
    x: np.ndarray,
    y: np.ndarray,
    fx: np.ndarray,
    fy: np.ndarray,
    count: int,
) -> None:
    """Compute forces [F*] of pairs within the radius; rebuild the list once half the skin is used."""
    stale = False
    for i in range(count):
        dx, dy = x[i] - known.built[0, i], y[i] - known.built[1, i]
        stale |= not dx * dx + dy * dy <= 0.25 * skin * skin
    if stale:
        _fill(known, x, y, count, radius + skin)
    fx[:] = 0.0
    fy[:] = 0.0
    for i in range(count):
        for k in range(known.begins[i], known.begins[i + 1]):
            j = known.partner[k]
            dx, dy = x[i] - x[j], y[i] - y[j]
            r2 = dx * dx + dy * dy
            if r2 < radius * radius:
                s = 0.75 / (r2 * r2 * math.sqrt(r2))
                fx[i] += s * dx
                fy[i] += s * dy
                fx[j] -= s * dx
                fy[j] -= s * dy


def jax_forces(positions: np.ndarray) -> Callable[[], Any]:
    """Make a call of the full matrix of pairs in JAX, in double precision, that returns forces (n, 2)."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]  # JAX has no types here
    index = jnp.asarray(positions, dtype=jnp.float64)

    @jax.jit
    def forces(index: Any) -> Any:
        delta = index[:, None] - index[None]
        r2 = (delta**2).sum(axis=2) + jnp.diag(jnp.full(len(index), jnp.inf))
        return 0.75 * (delta * (1.0 / (r2 * r2 * jnp.sqrt(r2)))[:, :, None]).sum(axis=1)

    return lambda: forces(index).block_until_ready()
