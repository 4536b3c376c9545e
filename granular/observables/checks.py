"""Checks of arrays that all observables share, and the grains that are present in a frame."""

from __future__ import annotations

import numpy as np

from granular.shared.errors import InputError


def checked_positions(positions: np.ndarray) -> np.ndarray:
    """Positions as float64 (n, 2).

    Raises
    ------
    InputError
        If they have another shape.
    """
    array = np.asarray(positions, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"positions have the shape {array.shape}; (n, 2) is wanted")
    return array


def checked_frames(frames: np.ndarray, least: int = 0) -> np.ndarray:
    """Positions of frames as float64 (f, n, 2).

    Raises
    ------
    InputError
        If they have another shape, or are fewer than ``least``.
    """
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; (f, n, 2) is wanted")
    if len(array) < least:
        raise InputError(f"{len(array)} frames; at least {least} are needed")
    return array


def present(positions: np.ndarray) -> np.ndarray:
    """Grains that are in the cell, bool (..., n) of positions (..., n, 2)."""
    return np.asarray(np.isfinite(positions).all(axis=-1))


def present_positions(positions: np.ndarray) -> np.ndarray:
    """Positions of the grains that are in the cell, (k, 2).

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2).
    """
    array = checked_positions(positions)
    return array[present(array)]


def values_of_grains(
    name: str, values: np.ndarray, count: int, width: int | None = None
) -> np.ndarray:
    """One value or row for each grain, float64 (count,) or (count, width).

    Raises
    ------
    InputError
        If the shape is another one.
    """
    array = np.asarray(values, dtype=np.float64)
    shape = (count,) if width is None else (count, width)
    if array.shape != shape:
        raise InputError(f"{name} has the shape {array.shape}; {shape} is wanted, one a grain")
    return array


def spanned_box(positions: np.ndarray) -> np.ndarray:
    """Box spanned by the outermost centres: lowest and highest x and y, float (2, 2) [m]."""
    points = present_positions(positions)
    if not len(points):
        return np.full((2, 2), np.nan)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def sum_at(indices: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sum of the values (k, ...) at each index (count, ...)."""
    total = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    np.add.at(total, indices, values)
    return total
