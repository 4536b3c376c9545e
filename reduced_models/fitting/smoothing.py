"""Height, velocity and acceleration of a motion at some times, by local cubics."""

from __future__ import annotations

import numpy as np

_HALF_WINDOW = 0.12  # in periods
_LEAST = 6  # samples within a window
_FEWEST = 8  # times that make a motion
_AT_ONCE = 2**16  # samples of windows, in memory
_CROWDED = 1e-13  # share of the greatest eigenvalue, below which there is nothing but rounding


def smoothed(
    time: np.ndarray, height: np.ndarray, period: float, nodes: np.ndarray | int
) -> np.ndarray:
    """Height, velocity, acceleration and time (4, n) of a motion, by a cubic about each time.

    ``nodes`` are the times, or how many, over all of the samples. Times without enough samples
    about them are left out; where hardly any has enough, the motion is that of the samples.
    """
    half = min(_HALF_WINDOW * period, 0.1 * float(time[-1] - time[0]))
    if isinstance(nodes, int):
        nodes = np.linspace(time[0] + half, time[-1] - half, nodes)
    places = np.clip(nodes, time[0] + half, time[-1] - half)
    first, last = (np.searchsorted(time, places + side * half) for side in (-1.0, 1.0))
    kept = (last - first >= _LEAST) & np.concatenate([[True], np.diff(places) > 0.0])
    if kept.sum() < _FEWEST:  # too few samples a period: straight from the samples
        speed = np.gradient(height, time)
        return np.stack([height, speed, np.gradient(speed, time), time])
    level, slope, bend = np.empty((3, int(kept.sum())))
    sizes = (last - first)[kept]
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size)
        for here in np.array_split(alike, 1 + size * len(alike) // _AT_ONCE):
            inside = first[kept][here, None] + np.arange(size)
            shifted = (time[inside] - places[kept][here, None]) / half
            level[here], slope[here], bend[here] = _cubics(shifted, height[inside])
    return np.stack([level, slope / half, 2.0 * bend / half**2, places[kept]])


def _cubics(place: np.ndarray, height: np.ndarray) -> np.ndarray:
    """First three coefficients (3, m) of cubics in places (m, n) from -1 to 1, by least squares."""
    from numpy.polynomial.legendre import legvander

    # In Legendre's polynomials, which are nearly orthogonal there; a pseudo-inverse, since samples
    # may crowd in a part of the window.
    basis = legvander(place, 3)
    turned = basis.transpose(0, 2, 1)
    inverse = np.linalg.pinv(turned @ basis, _CROWDED, hermitian=True)
    a, b, c, d = (inverse @ (turned @ height[:, :, None]))[:, :, 0].T
    return np.stack([a - 0.5 * c, b - 1.5 * d, 1.5 * c])
