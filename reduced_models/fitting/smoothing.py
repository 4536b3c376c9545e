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
    rows: list[tuple[float, ...]] = []
    for node in np.clip(nodes, time[0] + half, time[-1] - half):
        inside = slice(*np.searchsorted(time, (node - half, node + half)))
        if inside.stop - inside.start < _LEAST or (rows and node <= rows[-1][3]):
            continue
        place = (time[inside] - node) / half
        level, slope, bend, _ = np.polynomial.polynomial.polyfit(place, record.height[inside], 3)
        rows.append((level, slope / half, 2.0 * bend / half**2, node))
    if len(rows) < _FEWEST:  # too few samples a period: straight from the samples
        speed = np.gradient(record.height, time)
        return Smoothed(record.height, speed, np.gradient(speed, time), time)
    return Smoothed(*np.array(rows).T)
