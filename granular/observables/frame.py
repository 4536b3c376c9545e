"""Observables: functions of a frame with a unit, and their values at every frame of a run.

>>> @observable("N", "maximum force on a grain")
... def maximum_force(frame):
...     return np.nanmax(np.linalg.norm(frame.forces, axis=1))
>>> per_frame(run, maximum_force).plot()
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from granular.schema.units import unit_size
from granular.shared.array_types import Bool, Float, Int
from granular.shared.errors import InputError, quote

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


class Frame(NamedTuple):
    """State of a run at one time, in SI units; values of grains that have left the cell are NaN.

    Attributes
    ----------
    scene : Scene
        Scene of the run.
    time : float
        Time in the run [s].
    positions, velocities, forces : float (n, 2)
        Positions [m], wrapped into the cell if it is periodic; velocities [m/s]; forces [N]. The forces
        include magnetic and contact forces, weight, forces of user-defined laws and fields, and the inertial
        force in a shaken cell; drag and friction are not included.
    piston_height : float
        Height of the piston [m]; NaN without a piston.
    species : int (n,)
        Index of each grain's species.
    diameters, masses : float (n,)
        Diameters [m]; masses [kg].
    further_heights : float (p,)
        Heights of further pistons [m].
    """

    scene: Scene
    time: float
    positions: np.ndarray
    velocities: np.ndarray
    forces: np.ndarray
    piston_height: float
    species: np.ndarray
    diameters: np.ndarray
    masses: np.ndarray
    further_heights: np.ndarray = np.empty(0)

    @property
    def heights(self) -> np.ndarray:
        """Height of the piston, followed by the heights of further pistons (1 + p,) [m]."""
        return np.array([self.piston_height, *self.further_heights])


Value = float | np.ndarray | Mapping[Any, "float | np.ndarray"]
"""Value of an observable: one number; or, for each grain, a number (n,), a vector (n, 2) or a tensor
(n, 2, 2); or a mapping of labels to such values."""

Function = TypeVar("Function", bound=Callable[..., Any])


def observable(unit: str, meaning: str = "", name: str | None = None) -> Callable[[Function], Function]:
    """Decorate a function of a `Frame` as an observable, with the unit of its value.

    Parameters
    ----------
    unit : str
        Unit of the function's value, such as ``"N"`` or ``"mm/s"``; ``"1"`` if dimensionless.
    meaning : str
        Description in words, for the axis of a plot.
    name : str, optional
        Python identifier used in tables and commands; the function's name if not given.

    Returns
    -------
    function
        Decorator, which sets the attribute ``observable`` of a function and returns the function.

    Raises
    ------
    InputError
        If the unit cannot be parsed. The decorator raises this error if the name is missing or not an
        identifier.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import observable
    >>> @observable("N", "maximum force on a grain")
    ... def maximum_force(frame):
    ...     return np.nanmax(np.linalg.norm(frame.forces, axis=1))
    >>> maximum_force.observable.unit
    'N'
    """
    if unit != "1":
        unit_size(unit)

    def mark(function: Function) -> Function:
        identifier = getattr(function, "__name__", "") if name is None else name
        if not identifier.isidentifier():
            raise InputError(
                f"{quote(identifier)} cannot name an observable; use an identifier such as 'maximum_force'"
            )
        function.observable = Observable(identifier, unit, meaning)  # type: ignore[attr-defined]
        return function

    return mark


class Observable(NamedTuple):
    """Name, unit and meaning of a function's value."""

    name: str
    unit: str
    meaning: str


def observable_metadata(function: Any) -> Observable | None:
    """Return name, unit and meaning of a function decorated with `observable`; None for other functions."""
    result = getattr(function, "observable", None)
    return result if isinstance(result, Observable) else None


def select_frame_indices(run: Trajectory, start: float, stop: float) -> Int[np.ndarray, "f"]:
    """Select the indices of the frames with start <= time <= stop [s]."""
    times = run.dataset["frame_time"].values
    chosen = np.flatnonzero((times >= start) & (times <= stop))
    if not len(chosen):
        known = f"{times[0]:g} to {times[-1]:g} s" if len(times) else "none"
        raise InputError(f"no frame lies from {start:g} to {stop:g} s; the frames cover {known}")
    return chosen


def frames(run: Trajectory, indices: Sequence[int] | Int[np.ndarray, "f"] | None = None) -> Iterator[Frame]:
    """Yield frames of a run, by their indices."""
    from granular.run.trajectory import piston_heights_in_frames

    data = run.dataset if indices is None else run.dataset.isel(frame=np.asarray(indices))
    times, velocities, forces = (data[k].values for k in ("frame_time", "velocity", "force"))
    positions = run.scene.cell.wrap_positions(data["position"].values)
    of_grains = data["species"].values, data["diameter"].values, run.scene.grains.masses()
    heights = piston_heights_in_frames(run.scene, data)
    for k in range(len(times)):
        height = float("nan") if run.scene.piston is None else float(heights[k, 0])
        of_frame = positions[k], velocities[k], forces[k], height
        yield Frame(run.scene, float(times[k]), *of_frame, *of_grains, heights[k, 1:])


def frame_at(run: Trajectory, index: int = -1) -> Frame:
    """Return one frame of a run, given by its index; by default the last frame.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    index : int
        Index of the frame from 0; negative indices count from the end.

    Returns
    -------
    Frame
        The frame, in SI; NaN for grains that have left the cell.

    Raises
    ------
    InputError
        If the run has no frame with this index.
    """
    total = run.dataset.sizes["frame"]
    if not -total <= index < total:
        raise InputError(
            f"the run has {total} frames, but no frame {index}; use 0 to {total - 1}, or -{total} to -1 "
            "to count from the end"
        )
    return next(frames(run, [index]))


def labelled_array(values: Any, dims: Any, coords: Any, label: Observable | None) -> xarray.DataArray:
    """Make a data array from values, dimensions and coordinates; attach an observable's unit and meaning."""
    import xarray

    attributes = {} if label is None else {"units": label.unit, "long_name": label.meaning}
    return xarray.DataArray(values, dims=dims, coords=coords, attrs=attributes)


def labelled_columns(dim: str, columns: Mapping[str, tuple[Any, str, str]]) -> dict[str, Any]:
    """Make variables of a dataset along one dimension; each column is given as values, unit and meaning."""
    return {
        name: (dim, np.array(values, dtype=float), {"units": unit, "long_name": meaning})
        for name, (values, unit, meaning) in columns.items()
    }


def require_piston(scene: Scene) -> None:
    """Raise an error for a scene without a piston."""
    if scene.piston is None:
        raise InputError(f"scene {scene.name!r} has no piston; use a scene with [piston]")


def species_names(scene: Scene) -> list[str]:
    """Names of the species; if several species have the same name, their index is appended."""
    names = [specy.name for specy in scene.grains.species]
    return [name if names.count(name) == 1 else f"{name} {index}" for index, name in enumerate(names)]


def checked_vectors(vectors: Float[np.ndarray, "n 2"], name: str = "positions") -> Float[np.ndarray, "n 2"]:
    """Check the shape of positions or other vectors, and convert them to an array."""
    array = np.asarray(vectors, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{name} have the shape {array.shape}; the shape must be (n, 2)")
    return array


def checked_series(names: str, *series: np.ndarray) -> tuple[np.ndarray, ...]:
    """Check that series are one-dimensional and equally long, and convert them to arrays."""
    arrays = tuple(np.asarray(values, dtype=np.float64) for values in series)
    shapes = [array.shape for array in arrays]
    if len(shapes[0]) != 1 or len(set(shapes)) > 1:
        raise InputError(
            f"{names} have the shapes {', '.join(map(str, shapes))}; all must have the same shape (n,)"
        )
    return arrays


def checked_frames(frames: Float[np.ndarray, "f n 2"], minimum_count: int = 0) -> Float[np.ndarray, "f n 2"]:
    """Check the shape of positions [m] in frames and the number of frames, and convert them to an array."""
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; the shape must be (f, n, 2)")
    if len(array) < minimum_count:
        raise InputError(f"{len(array)} frames; {minimum_count} or more are needed")
    return array


def checked_or_default_lags(lags: Int[np.ndarray, "k"] | None, count: int) -> Int[np.ndarray, "k"]:
    """Check given lags between frames, or choose about 30 lags with logarithmic spacing."""
    if lags is None:
        return np.unique(np.geomspace(1, count - 1, 30).round().astype(int))
    array = np.asarray(lags)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer) or not len(array):
        raise InputError("lags are not a one-dimensional array of integers; pass numbers of frames")
    if array.min() < 1 or array.max() >= count:
        raise InputError(f"lags are from {array.min()} to {array.max()} frames; use 1 to {count - 1} frames")
    return array


def checked_period_lengths(periods: tuple[float, float]) -> Float[np.ndarray, "2"]:
    """Check the sides of a periodic cell [m], and convert them to an array."""
    array = np.asarray(periods, dtype=np.float64)
    if array.shape != (2,) or not (array > 0.0).all():
        raise InputError(f"periods = {periods}; pass width and height of the periodic cell, both above 0 m")
    return array


def present_grain_mask(positions: Float[np.ndarray, "... n 2"]) -> Bool[np.ndarray, "... n"]:
    """Return a mask that is True for the grains in the cell: those with finite positions [m]."""
    return np.asarray(np.isfinite(positions).all(axis=-1))


def present_positions(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Select the positions [m] of the grains that are in the cell."""
    array = checked_vectors(positions)
    return array[present_grain_mask(array)]


def checked_grain_values(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Check that there is one value for each grain, and convert the values to an array."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise InputError(
            f"{name} has the shape {array.shape}; the shape must be {(count,)}, one value per grain"
        )
    return array


def bounding_box(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 2"]:
    """Bounding box of the grains' centres [m]: lowest x and y, then highest x and y."""
    points = present_positions(positions)
    if not len(points):
        return np.full((2, 2), np.nan)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def sum_by_index(indices: Int[np.ndarray, "k"], values: np.ndarray, count: int) -> np.ndarray:
    """Sum the values that share an index, for each index below ``count``."""
    total = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    np.add.at(total, indices, values)
    return total
