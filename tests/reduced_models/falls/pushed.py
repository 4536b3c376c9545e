"""Responses of pushed pistons, simulated and by the law `annealing-bed`."""

from __future__ import annotations

from typing import NamedTuple


class Pushed(NamedTuple):
    """A pushed piston, simulated and by the law.

    Attributes
    ----------
    grains : int
        N.
    frequency, force : float
        f [Hz] and F [N].
    simulated, by_law : float
        Response [D sqrt(N/368)].
    """

    grains: int
    frequency: float
    force: float
    simulated: float
    by_law: float


PUSHED = (
    Pushed(368, 1.0, 9.6, 0.499, 0.504),
    Pushed(368, 1.0, 23.9, 1.476, 1.471),
    Pushed(368, 1.0, 35.8, 3.164, 3.084),
    Pushed(368, 2.0, 6.5, 0.498, 0.5),
    Pushed(368, 2.0, 19.4, 1.456, 1.471),
    Pushed(368, 2.0, 36.4, 3.016, 3.076),
    Pushed(368, 3.5, 1.0, 0.488, 0.489),
    Pushed(368, 3.5, 3.5, 1.595, 1.542),
    Pushed(368, 3.5, 9.3, 2.582, 2.973),
    Pushed(368, 5.0, 8.8, 0.508, 0.508),
    Pushed(368, 5.0, 30.0, 1.625, 1.5),
    Pushed(368, 5.0, 63.9, 3.058, 2.999),
    Pushed(368, 8.0, 31.7, 0.508, 0.512),
    Pushed(368, 8.0, 122.3, 1.668, 1.517),
    Pushed(368, 8.0, 183.2, 3.176, 2.987),
    Pushed(736, 1.0, 13.6, 0.491, 0.498),
    Pushed(736, 1.0, 34.6, 1.496, 1.496),
    Pushed(736, 1.0, 53.6, 3.039, 3.034),
    Pushed(736, 2.0, 8.1, 0.513, 0.504),
    Pushed(736, 2.0, 23.5, 1.453, 1.469),
    Pushed(736, 2.0, 42.7, 3.204, 3.059),
    Pushed(736, 3.5, 6.3, 0.455, 0.499),
    Pushed(736, 3.5, 22.3, 1.612, 1.518),
    Pushed(736, 3.5, 47.4, 2.885, 2.976),
    Pushed(736, 5.0, 24.8, 0.489, 0.505),
    Pushed(736, 5.0, 73.5, 1.727, 1.505),
    Pushed(736, 5.0, 138.3, 4.709, 3.701),
    Pushed(736, 8.0, 80.3, 0.521, 0.51),
    Pushed(736, 8.0, 264.8, 1.564, 1.497),
    Pushed(736, 8.0, 396.5, 4.348, 2.601),
)
