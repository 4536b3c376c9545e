"""Samples of a record on the uniform grid of a solution, as compiled code takes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reduced_models.records.inputs import STAGE_TIMES


class Samples(NamedTuple):
    """Data on a grid, as the compiled code takes them.

    Attributes
    ----------
    step : float
        Of the grid [s].
    place, share : int (n,), float (n,)
        Grid point before each sample, and how far behind it, in steps.
    height, weight : float (n,)
        [m]; weights multiply the residuals.
    drive : float (steps + 1, stages, inputs)
        Inputs of the law at the stages of the grid's steps.
    """

    step: float
    place: np.ndarray
    share: np.ndarray
    height: np.ndarray
    weight: np.ndarray
    drive: np.ndarray


def _undriven(steps: int) -> np.ndarray:
    return np.zeros((steps + 1, len(STAGE_TIMES), 0))


def samples_on_grid(
    time: np.ndarray, height: np.ndarray, steps: int, drive: np.ndarray | None = None
) -> Samples:
    """Every sample of a record that starts at time 0, on a grid over all of it."""
    step = float(time[-1]) / steps
    place = np.minimum((time / step).astype(np.int64), steps - 1)
    count = len(time)
    size = padded_size(count)
    whole, share, heights, weight = np.zeros(size, np.int64), *np.zeros((3, size))
    drive = _undriven(steps) if drive is None else drive
    out = Samples(step, whole, share, heights, weight, drive)
    out.place[:count], out.share[:count] = place, time / step - place
    out.height[:count], out.weight[:count] = height, 1.0
    return out


def means_on_grid(
    time: np.ndarray, height: np.ndarray, steps: int, drive: np.ndarray | None = None
) -> Samples:
    """Means of the samples around each grid point, weighted by how many there are."""
    step = float(time[-1]) / steps
    near = np.rint(time / step).astype(np.int64)
    count = np.bincount(near, minlength=steps + 1).astype(float)
    # The mean place of the samples is not the grid point: the slope takes that out.
    level = height - np.gradient(height, time) * (time - near * step)
    total = np.bincount(near, weights=level, minlength=steps + 1)
    means = np.divide(total, count, out=np.zeros(steps + 1), where=count > 0)
    place = np.minimum(np.arange(steps + 1), steps - 1)
    share = np.arange(steps + 1.0) - place
    drive = _undriven(steps) if drive is None else drive
    return Samples(step, place, share, means, np.sqrt(count), drive)


def padded_size(count: int) -> int:
    """Room for samples: few sizes, so that records share compiled code."""
    size = 256
    while size < count:
        size = size * 3 // 2 if size & (size - 1) == 0 else size // 3 * 4
    return size
