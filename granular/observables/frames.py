"""What all observables share: the grains present in a frame, and labelled results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def checked_positions(positions: np.ndarray) -> np.ndarray:
    """Positions as float64 (n, 2).

    Raises
    ------
    InputError
        If they have another shape.
    """
    array = np.asarray(positions, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"positions have the shape {array.shape}; (n, 2) is wanted")
    return array


def present(positions: np.ndarray) -> np.ndarray:
    """Which grains are in the cell, bool (..., n) of positions (..., n, 2)."""
    return np.asarray(np.isfinite(positions).all(axis=-1))


def present_positions(positions: np.ndarray) -> np.ndarray:
    """The positions of the grains that are in the cell, (k, 2).

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2).
    """
    array = checked_positions(positions)
    return array[present(array)]


def values_of_grains(
    name: str, values: np.ndarray, count: int, width: int | None = None
) -> np.ndarray:
    """One value or row a grain, float64 (count,) or (count, width).

    Raises
    ------
    InputError
        If the shape is another one.
    """
    array = np.asarray(values, dtype=np.float64)
    shape = (count,) if width is None else (count, width)
    if array.shape != shape:
        raise InputError(f"{name} has the shape {array.shape}; {shape} is wanted, one a grain")
    return array


def spanned_box(positions: np.ndarray) -> np.ndarray:
    """The box spanned by the outermost centres: lowest and highest x and y, float (2, 2) [m]."""
    points = present_positions(positions)
    if not len(points):
        return np.full((2, 2), np.nan)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def frame_positions(run: Trajectory) -> Iterator[np.ndarray]:
    """The positions of every frame, float (n, 2) [m]; within the cell where it is periodic."""
    return iter(run.scene.cell.inside(run.dataset["position"].values))


def piston_heights(run: Trajectory) -> np.ndarray:
    """Piston height of every frame (f,) [m].

    Raises
    ------
    InputError
        If the scene has no piston.
    """
    if run.scene.piston is None:
        raise InputError(
            f"scene {run.scene.name!r} has no piston; take a scene with [piston] for this"
        )
    return np.asarray(run.dataset["frame_height"].values)


def species_names(run: Trajectory) -> list[str]:
    """Names of the species, with their index where two have the same."""
    names = [one.name for one in run.scene.grains.species]
    return [
        name if names.count(name) == 1 else f"{name} {place}" for place, name in enumerate(names)
    ]


def frame_array(
    run: Trajectory,
    values: Any,
    unit: str,
    meaning: str,
    dims: tuple[str, ...] = ("frame",),
    coords: Mapping[str, Any] | None = None,
) -> xarray.DataArray:
    """Values of every frame, labelled with the time of the frame."""
    import xarray

    times = {"frame_time": run.dataset["frame_time"]} if "frame" in dims else {}
    return xarray.DataArray(
        np.asarray(values),
        dims=dims,
        coords={**times, **(coords or {})},
        attrs={"units": unit, "long_name": meaning},
    )


def frame_dataset(run: Trajectory, columns: Mapping[str, tuple[Any, str, str]]) -> xarray.Dataset:
    """Several values of every frame: (values, unit, meaning) by name."""
    import xarray

    return xarray.Dataset({name: frame_array(run, *column) for name, column in columns.items()})


def chosen_frames(run: Trajectory, start: float, stop: float) -> np.ndarray:
    """Indices of the frames with start <= time <= stop [s].

    Raises
    ------
    InputError
        If there is none.
    """
    times = run.dataset["frame_time"].values
    chosen = np.flatnonzero((times >= start) & (times <= stop))
    if not len(chosen):
        span = f"{times[0]:g} to {times[-1]:g} s" if len(times) else "none"
        raise InputError(f"no frame lies from {start:g} to {stop:g} s; there are frames of {span}")
    return chosen


def over_frames(run: Trajectory, measure: Callable[[np.ndarray], float]) -> np.ndarray:
    """A scalar of the positions, for every frame (f,)."""
    return np.array([measure(positions) for positions in frame_positions(run)], dtype=float)
