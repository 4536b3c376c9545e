"""A time step for a whole LAMMPS run, which cannot shorten it on the way as the engine does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from granular.effects import wall_experimental, wall_infinite
from granular.pairs import dipole

REACH = 6.0
"""Pairs up to here [D] count for the stiffness, which falls as distance^-5."""

_WALLS = {"experimental": wall_experimental, "infinite": wall_infinite}


def stiffest_frequency(
    place: np.ndarray, charge: np.ndarray, mass: np.ndarray, walls: Mapping[str, str],
    width: float, height: float, *, pairs: bool,
) -> float:  # fmt: skip
    """Bound of the highest angular frequency of a bed [1/tau], by Gershgorin's theorem.

    Parameters
    ----------
    place : float (n, 2)
        [D]
    charge, mass : float (n,)
        Moment and mass over those of the first species.
    walls : mapping of str to str
        Side and law.
    width, height : float
        Of the cell [D].
    pairs : bool
        Whether grains repel each other.
    """
    from scipy.spatial import cKDTree

    near = cKDTree(place).query_pairs(REACH if pairs else 0.0, output_type="ndarray")
    i, j = near[:, 0], near[:, 1]
    fifth = np.linalg.norm(place[i] - place[j], axis=1) ** -5.0
    size = len(place)
    sums = np.bincount(i, charge[j] * fifth, size) + np.bincount(j, charge[i] * fifth, size)
    # A pair's stiffness 4 * 3/4 q_i q_j/r^5 enters a row twice.
    rows = np.multiply(8.0 * dipole.STRENGTH, sums)
    gaps = {
        "left": place[:, 0], "right": width - place[:, 0],
        "bottom": place[:, 1], "top": height - place[:, 1],
    }  # fmt: skip
    for side, law in walls.items():
        rows += [_WALLS[law].stiffness(gap) for gap in gaps[side]]
    return math.sqrt(float((rows * (charge / mass)).max()))


def collision_frequency(
    speed: float, charges: Sequence[float], masses: Sequence[float], laws: set[str], *, pairs: bool
) -> float:
    """Highest angular frequency [1/tau] of a collision at that speed [D/tau].

    Two grains of a species meet head-on, or one of them meets a wall.
    """
    squares = []
    for charge, mass in zip(charges, masses, strict=True):
        ratio = charge / mass
        at = speed / math.sqrt(ratio)
        squares += [ratio * _WALLS[law].turning_stiffness(at) for law in laws]
        if pairs:
            squares.append(dipole.head_on_stiffness(speed, mass, charge))
    return math.sqrt(max(squares, default=0.0))
