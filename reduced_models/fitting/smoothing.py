"""Height, velocity and acceleration of a record at some times, by local cubics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord

_HALF_WINDOW = 0.12  # in periods
_LEAST = 6  # samples within a window
_FEWEST = 8  # times that make a motion


class Smoothed(NamedTuple):
    """A smoothed motion: height, velocity, acceleration and time, each (n,)."""

    height: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    time: np.ndarray


def smoothed(record: PistonRecord, period: float, nodes: np.ndarray | int) -> Smoothed:
    """The motion at some times, by a cubic through the samples about each.

    ``nodes`` are the times, or how many, over all of the record. Times without enough samples about
    them are left out; where hardly any has enough, the motion is that of the samples themselves.
    """
    time = record.time
    half = min(_HALF_WINDOW * period, 0.1 * float(time[-1] - time[0]))
    if isinstance(nodes, int):
        nodes = np.linspace(time[0] + half, time[-1] - half, nodes)
    places = np.clip(nodes, time[0] + half, time[-1] - half)
    first, last = (np.searchsorted(time, places + side * half) for side in (-1.0, 1.0))
    kept = (last - first >= _LEAST) & np.concatenate([[True], np.diff(places) > 0.0])
    if kept.sum() < _FEWEST:  # too few samples a period: straight from the samples
        speed = np.gradient(record.height, time)
        return Smoothed(record.height, speed, np.gradient(speed, time), time)
    cubics = [
        _cubic((time[a:b] - node) / half, record.height[a:b])
        for a, b, node in zip(first[kept], last[kept], places[kept], strict=True)
    ]
    level, slope, bend, _ = np.array(cubics).T
    return Smoothed(level, slope / half, 2.0 * bend / half**2, places[kept])


def _cubic(place: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Coefficients (4,) of the cubic in places (n,) from -1 to 1 with the least squares."""
    powers = place ** np.arange(4)[:, None]
    return np.linalg.lstsq(powers.T, height, rcond=None)[0]
