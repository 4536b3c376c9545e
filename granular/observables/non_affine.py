"""Strain of each grain's neighbourhood, and what of its motion no strain explains: D2min."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.frames import checked_positions, frame_array
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


class NonAffineMotion(NamedTuple):
    """Motion of the neighbours of each grain between two frames; NaN where it is not known.

    Attributes
    ----------
    d2min : float (n,)
        Mean square of what is left over by the best local strain [m^2].
    strain : float (n, 2, 2)
        The best local deformation gradient minus 1.
    """

    d2min: np.ndarray
    strain: np.ndarray


def non_affine_motion(first: np.ndarray, second: np.ndarray) -> NonAffineMotion:
    """D2min of each grain with an interior cell between two frames.

    The least mean over its Voronoi neighbours j in the first frame of

        |r_j'' - r_i'' - F (r_j' - r_i')|^2

    over all matrices F (Falk and Langer, Phys. Rev. E 57, 7192, 1998, who take the sum over the
    grains within a distance).

    Parameters
    ----------
    first, second : float (n, 2)
        Positions in both frames [m]; NaN for absent grains.

    Raises
    ------
    InputError
        If the shapes do not fit.
    """
    first, second = checked_positions(first), checked_positions(second)
    if first.shape != second.shape:
        raise InputError(f"{len(first)} and {len(second)} grains; give two frames of the same bed")
    cells = voronoi_cells(first)
    both = np.concatenate([cells.neighbours, cells.neighbours[:, ::-1]])
    before = first[both[:, 1]] - first[both[:, 0]]
    after = second[both[:, 1]] - second[both[:, 0]]
    known = np.isfinite(after).all(axis=1)
    i, before, after = both[known, 0], before[known], after[known]
    count = len(first)
    mixed = _sum_at(i, after[:, :, None] * before[:, None, :], count)
    square = _sum_at(i, before[:, :, None] * before[:, None, :], count)
    number = np.bincount(i, minlength=count)
    able = cells.interior & (number > 2) & np.isfinite(second).all(axis=1)
    gradient = np.full((count, 2, 2), np.nan)
    gradient[able] = np.linalg.solve(square[able], mixed[able].transpose(0, 2, 1)).transpose(
        0, 2, 1
    )
    rest = after - np.einsum("jab,jb->ja", gradient[i], before)
    total = np.bincount(i, (rest**2).sum(axis=1), minlength=count)
    d2min = np.where(able, total / np.maximum(number, 1), np.nan)
    return NonAffineMotion(d2min, gradient - np.eye(2))


def non_affine_series(run: Trajectory, every: int = 1) -> xarray.DataArray:
    """D2min of each grain since ``every`` frames before, on (``frame``, ``grain``) [m^2].

    Raises
    ------
    InputError
        If ``every`` is below 1.
    """
    if every < 1:
        raise InputError(f"every {every}; take 1 frame or more")
    frames = run.dataset["position"].values
    found = np.full(frames.shape[:2], np.nan)
    for k in range(every, len(frames)):
        # To where the neighbours are, in a periodic cell; the ways between frames stay.
        home = run.scene.cell.inside(frames[k - every]) - frames[k - every]
        found[k] = non_affine_motion(frames[k - every] + home, frames[k] + home).d2min
    return frame_array(run, found, "m^2", "non-affine motion D2min", ("frame", "grain"))


def _sum_at(places: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    total = np.zeros((count, *values.shape[1:]))
    np.add.at(total, places, values)
    return total
