"""Mean square displacement, and how far displacements are from a normal distribution."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.lags import checked_frames, checked_lags, over_lags_of_run
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


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
