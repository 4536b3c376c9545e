"""Mean distances of the grains' pairs, and the least distance of the grains to the piston."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import (
    frame_array,
    over_frames,
    piston_heights,
    present_positions,
    species_names,
)

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


BLOCK = 1024
"""Grains whose distances to all others are held at once."""


def mean_pair_distance(positions: np.ndarray) -> float:
    """The mean distance of two grains, over all n (n - 1)/2 pairs, as [D, eq. 2.1] reads.

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.

    Returns
    -------
    float
        [m]; NaN for fewer than two grains.

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
    >>> from granular.observables import mean_pair_distance
    >>> round(mean_pair_distance(places), 4)  # [m]
    0.0441
    """
    points = present_positions(positions)
    count = len(points)
    if count < 2:
        return np.nan
    return _sum_of_distances(points) / (count * (count - 1) / 2)


def source_pair_distance(positions: np.ndarray) -> float:
    """Half of `mean_pair_distance`: the convention of de Paula's tables and figures.

    De Paula's values (as in [D, Table 3.1]) are the sum over the pairs j > i divided by
    N (N - 1), while its eq. 2.1 sums over all i and j.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import source_pair_distance
    >>> round(source_pair_distance(places), 4)  # [m]
    0.0221
    """
    return 0.5 * mean_pair_distance(positions)


def pair_distance_series(run: Trajectory) -> xarray.DataArray:
    """`mean_pair_distance` of every frame [m], on ``frame``."""
    return frame_array(run, over_frames(run, mean_pair_distance), "m", "mean pair distance")


def _sum_of_distances(points: np.ndarray) -> float:
    from scipy.spatial.distance import cdist, pdist

    total = 0.0
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        total += float(pdist(block).sum())
        for later in range(start + BLOCK, len(points), BLOCK):
            total += float(cdist(block, points[later : later + BLOCK]).sum())
    return total


def least_piston_distance(positions: np.ndarray, piston_height: float) -> float:
    """Least distance of a grain's centre from the piston, the delta of [D, eq. 4.29].

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    piston_height : float
        [m]

    Returns
    -------
    float
        [m]; NaN without grains.

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
    >>> from granular.observables import least_piston_distance
    >>> round(least_piston_distance(places, piston_height=0.08), 4)  # [m]
    0.0099
    """
    points = present_positions(positions)
    return float(piston_height - points[:, 1].max()) if len(points) else np.nan


def piston_distance_series(run: Trajectory) -> xarray.DataArray:
    """`least_piston_distance` of every frame and species [m], on (``frame``, ``species_name``).

    The least over ``species_name`` is that of the bed.

    Raises
    ------
    InputError
        If the scene has no piston.
    """
    heights = piston_heights(run)
    positions = run.dataset["position"].values
    owner = run.dataset["species"].values
    names = species_names(run)
    values = [
        [least_piston_distance(frame[owner == k], height) for k in range(len(names))]
        for frame, height in zip(positions, heights, strict=True)
    ]
    return frame_array(
        run,
        np.reshape(values, (-1, len(names))),
        "m",
        "least distance of a grain's centre from the piston",
        ("frame", "species_name"),
        {"species_name": names},
    )
