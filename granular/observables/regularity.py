"""How regular the hexagonal Voronoi cells are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import frame_dataset, frame_positions
from granular.observables.voronoi import VoronoiCells, voronoi_cells

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def hexagon_regularity(cells: VoronoiCells) -> np.ndarray:
    """Regularity of each interior hexagon, 1 for a regular one and less for any other.

    Returns
    -------
    float (n,)
        4/sqrt(3) * area / (sum of the squares of the sides) [D, eq. 4.25]; NaN where the cell is no
        interior hexagon, for which alone 1 is the greatest value.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import hexagon_regularity, voronoi_cells
    >>> float(np.nanmean(hexagon_regularity(voronoi_cells(places))).round(3))
    1.0
    """
    hexagon = cells.interior & (cells.sides == 6)
    regularity = np.full(len(cells.sides), np.nan)
    regularity[hexagon] = 4.0 / np.sqrt(3.0) * cells.area[hexagon] / cells.side_squares[hexagon]
    return regularity


def regularity_series(run: Trajectory) -> xarray.Dataset:
    """Mean and standard deviation of the hexagon regularity of every frame [D, Fig. 4.10].

    Returns
    -------
    xarray.Dataset
        ``mean`` and ``deviation`` on ``frame``; NaN without interior hexagons.
    """
    means, deviations = [], []
    for positions in frame_positions(run):
        values = hexagon_regularity(voronoi_cells(positions))
        values = values[np.isfinite(values)]
        means.append(values.mean() if len(values) else np.nan)
        deviations.append(values.std() if len(values) else np.nan)
    return frame_dataset(
        run,
        {
            "mean": (means, "1", "mean regularity of the hexagons"),
            "deviation": (deviations, "1", "standard deviation of the regularity"),
        },
    )
