"""Fraction of a known slip that dislocation tracking finds, for synthetic dislocations that cross a lattice.

Near the rim of a bed dislocations cannot be detected, so tracking misses a part of the plastic strain inside
the bed. This part depends on the size of the bed, and is measured here on lattices as large as the beds.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from granular.observables.plasticity import (
    axial_strain_difference,
    mask_of_grains_with_interior_neighbours,
    plastic_distortion,
    slip_area_tensor,
)
from granular.observables.voronoi import voronoi_cells

ROWS = {184: 9, 368: 12}
"""Number of rows of the beds at rest under the piston, by number of grains."""

_STEP, _JITTER = 0.15, 0.01
_OFFSETS = (-4.0, 0.0, 3.3)
_POISSON, _CORE = 1.0 / 3.0, 0.09


@lru_cache(maxsize=4)
def strain_fractions_from_moves_and_in_total(count: int) -> tuple[float, float]:
    """Return the fraction of the inner plastic strain found by tracking: from moves, and in total.

    The result is the mean over dislocations that glide from below the lattice to above it, in both directions
    at 60 degrees to its rows, at three positions.

    Parameters
    ----------
    count : int
        Number of grains, a key of `ROWS`.
    """
    rows = ROWS[count]
    lattice = triangular_lattice_patch(round(count / rows), rows)
    result = [
        _strain_fractions_of_one_glide(lattice, rows, sign, offset)
        for sign in (1.0, -1.0)
        for offset in _OFFSETS
    ]
    moves, total = np.mean(result, axis=0)
    return float(moves), float(total)


def triangular_lattice_patch(columns: int, rows: int) -> np.ndarray:
    """Return a patch of the lattice (n, 2) with rows along x and spacing 1."""
    j, i = np.divmod(np.arange(columns * rows), columns)
    return np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j], axis=1)


def edge_dislocation_displacement(points: np.ndarray, core: np.ndarray, burgers: np.ndarray) -> np.ndarray:
    """Return the displacement (n, 2) of an edge dislocation in an elastic plane, with a soft core.

    Parameters
    ----------
    points : float (n, 2)
    core : float (2,)
    burgers : float (2,)
        Burgers vector of length 1.
    """
    across = np.array([-burgers[1], burgers[0]])
    x, y = (points - core) @ burgers, (points - core) @ across
    r2, turn, rest = x**2 + y**2 + _CORE, 1.0 / (2.0 * np.pi), 4.0 * (1.0 - _POISSON)
    along = turn * (np.arctan2(y, x) + 2.0 * x * y / (rest * r2))
    sideways = -turn * ((1.0 - 2.0 * _POISSON) * np.log(r2) + (x**2 - y**2) / r2) / rest
    return np.asarray(along[:, None] * burgers + sideways[:, None] * across)


def _strain_fractions_of_one_glide(
    lattice: np.ndarray, rows: int, sign: float, offset: float
) -> tuple[float, float]:
    burgers = np.array([0.5 * sign, np.sqrt(0.75)])
    middle = lattice.mean(axis=0) + np.array([offset + 0.3, 0.0])
    random = np.random.default_rng(1)
    ways = np.arange(-rows / 1.6, rows / 1.6, _STEP)
    frames = np.array(
        [
            lattice
            + edge_dislocation_displacement(lattice, middle + way * burgers, burgers)
            + _JITTER * random.normal(size=lattice.shape)
            for way in ways
        ]
    )
    slip = plastic_distortion(frames)
    cells = voronoi_cells(frames[0])
    known = mask_of_grains_with_interior_neighbours(cells)
    height = np.ptp(lattice[known, 1]) + np.sqrt(0.75)
    complete = slip_area_tensor(burgers, burgers * height / burgers[1]) / cells.area[known].sum()
    full = axial_strain_difference(complete[None])[0]
    return axial_strain_difference(slip.moves)[-1] / full, axial_strain_difference(slip.total)[-1] / full
