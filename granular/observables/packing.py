"""Packing fraction of the bed, its profile against height, and distances between grains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frame import (
    Observable,
    checked_grain_values,
    checked_vectors,
    labelled_array,
    present_grain_mask,
    present_positions,
    require_piston,
)
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory

BLOCK = 1024
"""Number of grains whose distances to all others are held in memory at the same time."""


def packing_fraction(diameters: np.ndarray, width: float, height: float | np.ndarray) -> np.ndarray:
    """Packing fraction: area of the grains divided by area of the cell [D, eq. 2.2].

    Parameters
    ----------
    diameters : float (n,)
        Diameters of the grains that are in the cell [m].
    width : float
        Width of the cell [m], above 0.
    height : float or float (...)
        Height of the piston [m], above 0.

    Returns
    -------
    float64 (...)
        Dimensionless fraction, in the shape of ``height``.

    Raises
    ------
    InputError
        If width or a height is not above 0 m.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import packing_fraction
    >>> print(packing_fraction(np.full(368, 0.006), width=0.36, height=0.12).round(3))
    0.241
    """
    _check_positive_length("width", width)
    _check_positive_length("height", height)
    covered = np.pi / 4.0 * float(np.sum(np.square(diameters)))
    return np.asarray(covered / (width * np.asarray(height, dtype=np.float64)))


def packing_fraction_series(run: Trajectory) -> xarray.DataArray:
    """Packing fraction below the piston at every recorded time of a run [D, eq. 2.2].

    The packing fraction is the area of the grains divided by the product of cell width and piston height. If
    grains leave the cell, the grains present in the last frame before each record are counted.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.

    Returns
    -------
    xarray.DataArray
        Dimensionless fraction on ``time`` [s].

    Raises
    ------
    InputError
        If the scene has no piston, or its height is not above 0 m at a record.
    """
    require_piston(run.scene)
    data = run.dataset
    heights = data["piston_height"].values
    fraction = packing_fraction(data["diameter"].values, run.scene.cell.width, heights)
    if "grain_count" in data:
        # Fraction of the grains' area still in the cell, at every record.
        areas = np.square(data["diameter"].values)
        fraction_left = present_grain_mask(data["position"].values) @ areas / areas.sum()
        latest = np.searchsorted(data["frame_time"].values, data["time"].values, side="right") - 1
        fraction = fraction * fraction_left[np.maximum(latest, 0)]
    label = Observable("packing", "1", "packing fraction")
    return labelled_array(fraction, "time", {"time": data["time"]}, label)


def _check_positive_length(name: str, values: float | np.ndarray) -> None:
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    wrong = ~(array > 0.0)
    if wrong.any():
        raise InputError(f"{name} = {array[wrong][0]:g} m; a value above 0 m is needed")


def area_fraction_profile(
    positions: np.ndarray, diameters: np.ndarray, width: float, edges: np.ndarray
) -> np.ndarray:
    """Area fraction of grains in each horizontal strip of the cell, computed exactly.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    diameters : float (n,)
        Diameters of the grains [m], above 0.
    width : float
        Width of the cell [m], above 0.
    edges : float (k + 1,)
        Heights of the strips' edges [m], two or more, increasing.

    Returns
    -------
    float64 (k,)
        Local area fraction of each strip [D, Fig. 3.2], dimensionless; 0 in a strip without grains.

    Raises
    ------
    InputError
        If shapes do not match, the diameter of a present grain or the width is not above 0 m, there are fewer
        than two edges, or they do not increase.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import area_fraction_profile
    >>> strips = np.array([0.0, 0.03, 0.06])
    >>> print(area_fraction_profile(places, np.full(100, 0.006), 0.09, strips).round(2))
    [0.39 0.4 ]
    """
    positions = checked_vectors(positions)
    diameters = checked_grain_values("diameters", diameters, len(positions))
    edges = np.asarray(edges, dtype=np.float64)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0.0).all():
        raise InputError("the edges must be 2 or more increasing heights; sort the edges")
    _check_positive_length("width", width)
    present = present_grain_mask(positions)
    _check_positive_length("diameter", diameters[present])
    covered = _disc_area_between_lines(positions[present, 1], diameters[present] / 2.0, edges)
    return np.asarray(covered / (width * np.diff(edges)))


def area_fraction_by_depth(run: Trajectory, thickness: float | None = None) -> xarray.DataArray:
    """Local area fraction of every frame as a function of the depth below the piston [D, Fig. 3.2].

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    thickness : float, optional
        Thickness of the strips [m], above 0; a diameter of the first species if not given.

    Returns
    -------
    xarray.DataArray
        Dimensionless fraction on (``frame``, ``depth``), from `area_fraction_profile`; ``depth`` is the depth
        of the middle of each strip below the piston [m]. If a strip extends below the bottom of the cell,
        only its part in the cell is used; strips below the bottom have NaN.

    Raises
    ------
    InputError
        If the scene has no piston, or the thickness is not finite and above 0 m.
    """
    require_piston(run.scene)
    heights = run.dataset["frame_height"].values
    step = run.scene.grains.species[0].diameter if thickness is None else thickness
    if not 0.0 < step < np.inf:
        raise InputError(f"thickness = {step:g} m; a finite value above 0 m is needed")
    deepest = float(heights.max()) if len(heights) else 0.0
    depths = step * np.arange(max(1, int(np.ceil(deepest / step - 1e-9))) + 1)
    profiles = [
        _frame_area_fraction_by_depth(run, frame, height, depths)
        for frame, height in zip(run.dataset["position"].values, heights, strict=True)
    ]
    middle = ("depth", 0.5 * (depths[:-1] + depths[1:]), {"units": "m", "long_name": "depth"})
    values, label = np.reshape(profiles, (-1, len(depths) - 1)), Observable("", "1", "local area fraction")
    coordinates = {"frame_time": run.dataset["frame_time"], "depth": middle}
    return labelled_array(values, ("frame", "depth"), coordinates, label)


def _frame_area_fraction_by_depth(
    run: Trajectory, positions: np.ndarray, height: float, depths: np.ndarray
) -> np.ndarray:
    bounds = np.maximum(height - depths, 0.0)
    inside = np.diff(bounds) < 0.0
    profile = np.full(len(depths) - 1, np.nan)
    # The first strips lie in the cell; heights increase from the last of them upwards.
    edges = bounds[: np.count_nonzero(inside) + 1][::-1]
    diameters = run.dataset["diameter"].values
    result = area_fraction_profile(positions, diameters, run.scene.cell.width, edges)
    profile[: len(result)] = result[::-1]
    return profile


def _disc_area_between_lines(centres: np.ndarray, radii: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Total area (k - 1,) of all discs between successive horizontal lines."""
    u = np.clip((lines[:, None] - centres) / radii, -1.0, 1.0)
    parts = np.arcsin(u) + u * np.sqrt(1.0 - u**2) + 0.5 * np.pi
    # Differences are taken disc by disc, so that a strip that no disc reaches has exactly zero area.
    return np.asarray(np.diff(parts, axis=0) @ radii**2)


def mean_pair_distance(positions: np.ndarray) -> float:
    """Mean distance between two grains, averaged over all n (n - 1)/2 pairs [D, eq. 2.1].

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.

    Returns
    -------
    float
        Distance [m]; NaN for fewer than two grains.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2).

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
    return _sum_of_pair_distances(points) / (count * (count - 1) / 2)


def depaula_pair_distance(positions: np.ndarray) -> float:
    """Half of `mean_pair_distance`: the definition used in de Paula's tables and figures.

    De Paula's values (as in [D, Table 3.1]) are the sum over the pairs j > i, divided by N (N - 1). Eq. 2.1
    of [D] has the same divisor, but sums over all i and j.

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.

    Returns
    -------
    float
        Half the mean distance over all pairs [m]; NaN for fewer than two grains.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2).

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import depaula_pair_distance
    >>> round(depaula_pair_distance(places), 4)  # [m]
    0.0221
    """
    return 0.5 * mean_pair_distance(positions)


def _sum_of_pair_distances(points: np.ndarray) -> float:
    from scipy.spatial.distance import cdist, pdist

    total = 0.0
    for start in range(0, len(points), BLOCK):
        block = points[start : start + BLOCK]
        total += float(pdist(block).sum())
        for later in range(start + BLOCK, len(points), BLOCK):
            total += float(cdist(block, points[later : later + BLOCK]).sum())
    return total


def least_piston_distance(positions: np.ndarray, piston_height: float) -> float:
    """Minimum distance of a grain's centre from the piston, called delta in [D, eq. 4.29].

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    piston_height : float
        Height of the piston [m].

    Returns
    -------
    float
        Distance [m], negative if a centre is above the piston; NaN without grains.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2).

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
