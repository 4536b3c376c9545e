"""Packing fraction: the share of the cell's area that the grains cover."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import piston_heights, present
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def packing_fraction(diameters: np.ndarray, width: float, height: float | np.ndarray) -> np.ndarray:
    """Area of the grains over that of the cell [D, eq. 2.2].

    Parameters
    ----------
    diameters : float (n,)
        Of the grains that are in the cell [m].
    width : float
        Of the cell [m].
    height : float or float (...)
        Of the piston [m].

    Returns
    -------
    float (...)
        In the shape of ``height``.

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
    _check_above_zero("width", width)
    _check_above_zero("height", height)
    covered = np.pi / 4.0 * float(np.sum(np.square(diameters)))
    return np.asarray(covered / (width * np.asarray(height, dtype=np.float64)))


def packing_series(run: Trajectory) -> xarray.DataArray:
    """Packing fraction below the piston, on ``time``.

    Where grains leave the cell, those of the latest frame count.

    Raises
    ------
    InputError
        If the scene has no piston.
    """
    import xarray

    piston_heights(run)
    data = run.dataset
    heights = data["piston_height"].values
    fraction = packing_fraction(data["diameter"].values, run.scene.cell.width, heights)
    if "grain_count" in data:
        fraction = fraction * _share_left(run)
    return xarray.DataArray(
        fraction,
        dims="time",
        coords={"time": data["time"]},
        attrs={"units": "1", "long_name": "packing fraction"},
    )


def _share_left(run: Trajectory) -> np.ndarray:
    """The share of the grains' area that is still in the cell, at every record."""
    data = run.dataset
    areas = np.square(data["diameter"].values)
    left = present(data["position"].values) @ areas / areas.sum()
    latest = np.searchsorted(data["frame_time"].values, data["time"].values, side="right") - 1
    return np.asarray(left[np.maximum(latest, 0)])


def _check_above_zero(name: str, values: float | np.ndarray) -> None:
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    wrong = ~(array > 0.0)
    if wrong.any():
        raise InputError(f"{name} = {array[wrong][0]:g} m; give a length above 0 m")
