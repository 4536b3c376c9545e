"""Means over all pairs of frames that lie a number of frames apart."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.frames import chosen_frames
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
