"""Bond-orientational order: Psi6 of each grain and of the bed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import checked_positions, frame_array, over_frames
from granular.observables.voronoi import VoronoiCells, voronoi_cells

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def local_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> np.ndarray:
    """The complex bond order of each grain, mean over its Voronoi neighbours of exp(6 i theta).

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    cells : VoronoiCells, optional
        Of the same positions, where they are there already.

    Returns
    -------
    complex (n,)
        NaN for absent grains and for grains without neighbours. Grains at the rim have a value too;
        see ``cells.interior``.

    Raises
    ------
    InputError
        If the positions have another shape.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import local_psi6
    >>> float(np.nanmax(np.abs(local_psi6(places))).round(3))
    1.0
    """
    positions = checked_positions(positions)
    cells = voronoi_cells(positions) if cells is None else cells
    i, j = cells.neighbours.T
    arm = positions[j] - positions[i]
    bond = arm[:, 0] + 1j * arm[:, 1]
    # exp(6 i theta) is the same from both ends of a bond.
    turn = (bond / np.abs(bond)) ** 6
    total = _sum_at(i, turn, len(positions)) + _sum_at(j, turn, len(positions))
    known = cells.sides > 0
    local = np.full(len(positions), complex(np.nan, np.nan))
    local[known] = total[known] / cells.sides[known]
    return local


def psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> float:
    """Psi6 = mean of |local Psi6| over the grains with an interior cell [D, eq. 4.28].

    1 for a perfect hexagonal arrangement, whatever its orientations. NaN without interior cells.
    The arguments are those of `local_psi6`.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import psi6
    >>> round(psi6(places), 3)
    1.0
    """
    cells = voronoi_cells(positions) if cells is None else cells
    sizes = np.abs(local_psi6(positions, cells)[cells.interior])
    return float(sizes.mean()) if len(sizes) else np.nan


def global_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> complex:
    """Mean of the complex local Psi6 over the grains with an interior cell.

    Its size is 1 only where all hexagons have the same orientation. NaN without interior cells. The
    arguments are those of `local_psi6`.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import global_psi6
    >>> round(abs(global_psi6(places)), 3)
    1.0
    """
    cells = voronoi_cells(positions) if cells is None else cells
    values = local_psi6(positions, cells)[cells.interior]
    return complex(values.mean()) if len(values) else complex(np.nan, np.nan)


def psi6_series(run: Trajectory) -> xarray.DataArray:
    """`psi6` of every frame, on ``frame``."""
    return frame_array(run, over_frames(run, psi6), "1", "bond-orientational order Psi6")


def _sum_at(places: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(
        np.bincount(places, values.real, minlength=count)
        + 1j * np.bincount(places, values.imag, minlength=count)
    )
