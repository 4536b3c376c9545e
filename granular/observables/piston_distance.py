"""Least distance of a grain from the piston."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import (
    frame_array,
    piston_heights,
    present_positions,
    species_names,
)

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


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
