"""The dynamic Lindemann parameter: how far neighbours move against each other."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from granular.observables.lags import checked_frames, checked_lags, over_lags_of_run
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def lindemann_parameter(
    frames: np.ndarray,
    lags: np.ndarray | None = None,
    periods: tuple[float, float] | None = None,
) -> np.ndarray:
    """gamma(t) = <|du_i(t) - du_j(t)|^2>/(2 a^2) over neighbours i and j.

    du is the way of a grain in the time t, neighbours are those of the Voronoi cells of the earlier
    frame with an interior cell both, and a is the spacing of the hexagonal lattice of the mean cell
    area. It stays finite in a crystal in two dimensions, where the mean square displacement does
    not (Zahn, Lenke and Maret, Phys. Rev. Lett. 82, 2721, 1999); in layers of dipoles it stays
    below 0.033 up to melting (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames; about 30 at even ratios if not given.
    periods : (float, float), optional
        Sides of a periodic cell [m], in which neighbours are looked for; positions are then those
        that were not brought back.

    Returns
    -------
    float (k,)

    Raises
    ------
    InputError
        If a shape or lag does not fit, or in no frame two neighbours have interior cells.
    """
    frames = checked_frames(frames)
    lags = checked_lags(lags, len(frames))
    total, number = np.zeros((2, len(lags)))
    areas = []
    for first, start in enumerate(frames[:-1]):
        cells = voronoi_cells(start if periods is None else np.mod(start, periods))
        i, j = cells.neighbours[cells.interior[cells.neighbours].all(axis=1)].T
        areas.append(cells.area[cells.interior])
        for k, lag in enumerate(lags):
            if first + lag < len(frames):
                way = frames[first + lag] - start
                square = ((way[i] - way[j]) ** 2).sum(axis=1)
                known = np.isfinite(square)
                total[k] += square[known].sum()
                number[k] += np.count_nonzero(known)
    area = np.concatenate(areas)
    if not len(area) or not number.all():
        raise InputError("no neighbours have interior cells in both frames; give a larger bed")
    return np.asarray(total / number / (2.0 * 2.0 / np.sqrt(3.0) * area.mean()))


def lindemann_of_run(run: Trajectory, start: float = 0.0, stop: float = np.inf) -> xarray.DataArray:
    """`lindemann_parameter` over the frames with start <= time <= stop [s], on ``lag`` [s].

    Raises
    ------
    InputError
        As `lindemann_parameter`, and if the frames are not evenly spaced in time.
    """
    measure = functools.partial(lindemann_parameter, periods=run.scene.cell.periods)
    return over_lags_of_run(run, measure, start, stop, "1", "dynamic Lindemann parameter")
