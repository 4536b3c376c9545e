"""Displacements of grains: their mean square, their shape and Lindemann's parameter."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.frames import chosen_frames
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


EVEN = 1e-6
"""How far the times between frames may differ from one another, over their mean."""


def checked_frames(frames: np.ndarray) -> np.ndarray:
    """Positions of frames as float64 (f, n, 2).

    Raises
    ------
    InputError
        If they have another shape, or are fewer than two.
    """
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; (f, n, 2) is wanted")
    if len(array) < 2:
        raise InputError(f"{len(array)} frames; motion needs at least 2")
    return array


def checked_lags(lags: np.ndarray | None, count: int) -> np.ndarray:
    """Numbers of frames from 1 to ``count - 1``; about 30 at even ratios where none are given.

    Raises
    ------
    InputError
        If one is no such number.
    """
    if lags is None:
        return np.unique(np.geomspace(1, count - 1, 30).round().astype(int))
    array = np.asarray(lags)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer) or not len(array):
        raise InputError("lags are whole numbers of frames; give an array of them")
    if array.min() < 1 or array.max() >= count:
        raise InputError(f"lags from {array.min()} to {array.max()}; take 1 to {count - 1} frames")
    return array


def over_lags_of_run(
    run: Trajectory, measure: Callable[[np.ndarray, np.ndarray], Any], start: float, stop: float,
    unit: str, meaning: str,
) -> xarray.DataArray:  # fmt: skip
    """A function of frames (f, n, 2) and lags (k,), on ``lag`` [s].

    Raises
    ------
    InputError
        If the frames from start to stop are not evenly spaced in time, or fewer than two.
    """
    import xarray

    chosen = chosen_frames(run, start, stop)
    frames = checked_frames(run.dataset["position"].values[chosen])
    times = run.dataset["frame_time"].values[chosen]
    steps = np.diff(times)
    if np.ptp(steps) > EVEN * len(steps) * steps.mean():
        raise InputError(
            f"frames lie {steps.min():.3g} to {steps.max():.3g} s apart; choose start and stop "
            "within one stage of even frames"
        )
    lags = checked_lags(None, len(frames))
    return xarray.DataArray(
        np.asarray(measure(frames, lags)),
        dims="lag",
        coords={"lag": ("lag", lags * steps.mean(), {"units": "s"})},
        attrs={"units": unit, "long_name": meaning},
    )


def mean_square_displacement(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """<|r(t) - r(0)|^2> over grains and frames (k,) [m^2].

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames; about 30 at even ratios if not given.

    Raises
    ------
    InputError
        If a shape or lag does not fit, or no grain is present in two such frames.
    """
    return _powers(frames, lags)[0]


def non_gaussian_parameter(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """alpha_2(t) = <r^4>/(2 <r^2>^2) - 1 of the ways r in the time t; 0 if they are normal.

    In two dimensions (Rahman, Phys. Rev. 136, A405, 1964, has it in three). It peaks where some
    grains leave their cages and others do not. NaN where nothing moves. Arguments and errors as of
    `mean_square_displacement`.
    """
    second, fourth = _powers(frames, lags)
    squared = np.where(second > 0.0, second, np.nan) ** 2
    return np.asarray(fourth / (2.0 * squared) - 1.0)


def displacement_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """`mean_square_displacement` over the frames with start <= time <= stop [s], on ``lag`` [s]."""
    return over_lags_of_run(
        run, mean_square_displacement, start, stop, "m^2", "mean square displacement"
    )


def non_gaussian_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """`non_gaussian_parameter` over the frames with start <= time <= stop [s], on ``lag`` [s]."""
    return over_lags_of_run(
        run, non_gaussian_parameter, start, stop, "1", "non-Gaussian parameter alpha_2"
    )


def _powers(frames: np.ndarray, lags: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Means of the second and fourth power of the ways."""
    frames = checked_frames(frames)
    found = []
    for lag in checked_lags(lags, len(frames)):
        squares = ((frames[lag:] - frames[:-lag]) ** 2).sum(axis=2)
        squares = squares[np.isfinite(squares)]
        if not len(squares):
            raise InputError(f"no grain is present in two frames {lag} apart; take shorter lags")
        found.append((squares.mean(), (squares**2).mean()))
    second, fourth = np.array(found).T
    return second, fourth


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
