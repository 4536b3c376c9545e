"""Piecewise polynomial tables of functions of a squared distance, for compiled loops.

The width of a piece is a fixed fraction of the squared distance, so the exponent and the leading binary
digits of the squared distance give the index of the piece. A piece whose polynomial is not accurate enough
(at a kink, or at the square-root singularity of touching discs) is halved recursively. A piece consists of
its middle, six coefficients and one more number, which fill one line of the processor's cache.

For an energy E(u) with u = r^2, a table holds the energy in the middle of each piece, and the polynomial
F/r = -2 dE/du, where E is the polynomial fitted to the energy. The force is therefore minus the gradient of
the energy up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from granular.compiled import compiled
from granular.shared.array_types import Float, Int

Samples = NDArray[np.float64]
Sampled = Callable[[Samples], tuple[Samples, Samples]]
"""Function that maps squared distances (n,) to values (n,) and to magnitudes (n,); tolerances are fractions
of these magnitudes.
"""

_DIGITS = 5
"""Number of leading binary digits of a squared distance that select the piece: 32 pieces per factor of two.
For 1/r^3 the relative errors are then 1e-14 for the polynomials and 2e-11 for their derivatives.
"""

_SHIFT = 52 - _DIGITS
"""Number of the remaining binary digits of a squared distance; a double has 52 in all (IEEE 754)."""

_ORDER = 6
"""Number of coefficients of a piece, which with two more numbers fill a cache line of 64 bytes."""

_MAX_HALVINGS = 26
"""Maximum number of times that a piece is halved; a jump is then located to within 1e-9."""

_NEIGHBOUR_PIECES = 8
"""Number of neighbouring pieces on each side whose magnitudes enter the error bound of a piece. Near the end
of a function, the piece's magnitude alone would be only rounding error.
"""

_MAX_PIECES = 20000
"""Number of pieces (1.3 MB) above which no piece is halved any more, for functions that are nowhere smooth.
"""

MIDDLE, FIRST, ENERGY = 0, 1, 7
"""Entries of a piece: middle [D^2]; first coefficient; energy in the middle [F* D]."""

_CHECK_POINTS = np.array([-1.0, -0.8, -0.35, 0.15, 0.6, 0.95, 1.0])
"""Points on a piece, scaled to [-1, 1], at which polynomial and function are compared."""


class PiecewiseTable(NamedTuple):
    """Tables of a function, one for each pair of species, stored one after another."""

    pieces: Float[np.ndarray, "p*n 8"]  # see `MIDDLE` to `ENERGY`
    halves: Int[np.ndarray, "p*n"]  # index of the lower half of a halved piece; 0: not halved
    length: int  # number of pieces of a table, n
    start: int  # leading digits of the lowest squared distance
    last: int  # index, in a table, of the last piece that is not a half


def tabulate_energies(
    energies: Sequence[Sampled], low: float, high: float, tolerance: float, order: Sequence[int] | None = None
) -> PiecewiseTable:
    """Tabulate energies between two squared distances; ``order`` gives the energy's index for each row."""
    tables = [
        _fit_pieces_and_halved_indices(sampled, low, high, tolerance, _force_pieces_errors_and_magnitudes)
        for sampled in energies
    ]
    return _join_tables(tables if order is None else [tables[k] for k in order], low, high)


def tabulate_values(values: Sequence[Sampled], low: float, high: float, tolerance: float) -> PiecewiseTable:
    """Tabulate functions by their values, which `tabulated_force_over_distance` returns."""
    made = [
        _fit_pieces_and_halved_indices(sampled, low, high, tolerance, _value_pieces_errors_and_magnitudes)
        for sampled in values
    ]
    return _join_tables(made, low, high)


def _piece_number_before_halving(square: float) -> int:
    return int(np.float64(square).view(np.int64) >> _SHIFT)


def _join_tables(
    made: Sequence[tuple[Samples, NDArray[np.int64]]], low: float, high: float
) -> PiecewiseTable:
    most, start = max(len(pieces) for pieces, _ in made), _piece_number_before_halving(low)
    rows, links = np.zeros((len(made), most, 8)), np.zeros((len(made), most), dtype=np.int64)
    for row, (pieces, halves) in enumerate(made):
        rows[row, : len(pieces)] = pieces
        links[row, : len(pieces)] = halves + row * most * (halves > 0)
    return PiecewiseTable(
        rows.reshape(-1, 8), links.ravel(), most, start, _piece_number_before_halving(high) - start
    )


def _fit_pieces_and_halved_indices(
    sampled: Sampled,
    low: float,
    high: float,
    tolerance: float,
    fit: Callable[[Sampled, Samples, Samples], tuple[Samples, Samples, Samples]],
) -> tuple[Samples, NDArray[np.int64]]:
    """Fit the pieces of one table; return them, and for each halved piece the index of its lower half."""
    edges = (
        np.arange(_piece_number_before_halving(low), _piece_number_before_halving(high) + 2) << _SHIFT
    ).view(np.float64)
    lower, upper = edges[:-1], edges[1:]
    pieces, halves, bounds = np.zeros((0, 8)), np.zeros(0, dtype=np.int64), np.zeros(0)
    for depth in range(_MAX_HALVINGS + 1):
        made, errors, sizes = fit(sampled, lower, upper)
        if depth == 0:
            around = np.pad(np.nan_to_num(sizes), _NEIGHBOUR_PIECES, mode="edge")
            bounds = tolerance * np.lib.stride_tricks.sliding_window_view(
                around, 2 * _NEIGHBOUR_PIECES + 1
            ).max(axis=1)
        inaccurate = np.flatnonzero(errors > bounds)
        if depth == _MAX_HALVINGS or len(pieces) > _MAX_PIECES:
            inaccurate = inaccurate[:0]
        links = np.zeros(len(made), dtype=np.int64)
        links[inaccurate] = len(pieces) + len(made) + 2 * np.arange(len(inaccurate))
        pieces, halves = np.concatenate([pieces, made]), np.concatenate([halves, links])
        if not len(inaccurate):
            break
        bounds, middle = np.repeat(bounds[inaccurate], 2), 0.5 * (lower[inaccurate] + upper[inaccurate])
        lower, upper = (
            np.column_stack(ends).ravel()
            for ends in ((lower[inaccurate], middle), (middle, upper[inaccurate]))
        )
    return pieces, halves


def _chebyshev_nodes_and_power_matrix(count: int) -> tuple[Samples, Samples]:
    """Return nodes on (-1, 1), and the matrix that converts values at the nodes to coefficients of powers."""
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return nodes, np.linalg.inv(np.vander(nodes, increasing=True)).T


def _polynomials_errors_and_magnitudes(
    sampled: Sampled, lower: Samples, upper: Samples, count: int
) -> tuple[Samples, Samples, Samples]:
    """Return polynomials (n, count) on pieces scaled to [-1, 1], errors (n,), and largest magnitudes (n,)."""
    nodes, to_powers = _chebyshev_nodes_and_power_matrix(count)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    points = middle[:, None] + half[:, None] * np.concatenate([nodes, _CHECK_POINTS])
    values, magnitudes = (part.reshape(points.shape) for part in sampled(points.ravel()))
    powers = values[:, :count] @ to_powers
    differences = powers @ np.vander(_CHECK_POINTS, count, increasing=True).T - values[:, count:]
    return powers, np.abs(differences).max(axis=1), np.abs(magnitudes).max(axis=1)


def _force_pieces_errors_and_magnitudes(
    energy: Sampled, lower: Samples, upper: Samples
) -> tuple[Samples, Samples, Samples]:
    powers, errors, sizes = _polynomials_errors_and_magnitudes(energy, lower, upper, _ORDER + 1)
    half, orders = 0.5 * (upper - lower), np.arange(1, _ORDER + 1)
    slopes = -2.0 * orders * powers[:, 1:] / half[:, None] ** orders
    return np.column_stack([0.5 * (lower + upper), slopes, powers[:, 0]]), errors, sizes


def _value_pieces_errors_and_magnitudes(
    values: Sampled, lower: Samples, upper: Samples
) -> tuple[Samples, Samples, Samples]:
    powers, errors, sizes = _polynomials_errors_and_magnitudes(values, lower, upper, _ORDER)
    scaled = powers / (0.5 * (upper - lower))[:, None] ** np.arange(_ORDER)
    return np.column_stack([0.5 * (lower + upper), scaled, np.zeros(len(lower))]), errors, sizes


@compiled(inline=True)
def find_piece_index(table: PiecewiseTable, row: int, square: float) -> np.uint64:
    """Return the index of the piece at a squared distance; beyond the table, of its first or last piece."""
    index: Any = (np.float64(square).view(np.int64) >> _SHIFT) - table.start
    # An unsigned index is not checked for counting from the end.
    k = np.uint64(row * table.length + min(max(index, 0), table.last))
    half = table.halves[k]
    while half > 0:
        k = np.uint64(half) + np.uint64(square > table.pieces[k, MIDDLE])
        half = table.halves[k]
    return k


@compiled(inline=True)
def tabulated_force_over_distance(table: PiecewiseTable, row: int, square: float) -> float:
    """Return F/r of a tabulated energy, or the value of a tabulated function, at a squared distance."""
    return force_over_distance_in_piece(table, find_piece_index(table, row, square), square)


@compiled(inline=True)
def force_over_distance_in_piece(table: PiecewiseTable, k: np.uint64, square: float) -> float:
    """Return F/r of a tabulated energy, or the value of a tabulated function, within piece ``k``."""
    p = table.pieces
    t = square - p[k, 0]
    inner = p[k, 4] + t * (p[k, 5] + t * p[k, 6])
    return p[k, 1] + t * (p[k, 2] + t * (p[k, 3] + t * inner))


@compiled(inline=True)
def tabulated_energy(table: PiecewiseTable, row: int, square: float) -> float:
    """Return the tabulated energy at a squared distance."""
    k, p = find_piece_index(table, row, square), table.pieces
    t = square - p[k, 0]
    inner = p[k, 4] / 4.0 + t * (p[k, 5] / 5.0 + t * p[k, 6] / 6.0)
    passed = p[k, 1] + t * (p[k, 2] / 2.0 + t * (p[k, 3] / 3.0 + t * inner))
    return p[k, 7] - 0.5 * t * passed


@compiled(inline=True)
def tabulated_slope_of_force_over_distance(table: PiecewiseTable, row: int, square: float) -> float:
    """Return d(F/r)/d(r^2) at a squared distance."""
    k, p = find_piece_index(table, row, square), table.pieces
    t = square - p[k, 0]
    inner = 3.0 * p[k, 4] + t * (4.0 * p[k, 5] + 5.0 * t * p[k, 6])
    return p[k, 2] + t * (2.0 * p[k, 3] + t * inner)
