"""Values of observables at every frame of a run, by function or by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.catalogue import OBSERVABLES
from granular.observables.frame import Frame, Value, chosen_frames, frames, observable_of
from granular.schema.sections import unknown
from granular.shared.errors import GranularError, InputError
from granular.shared.messages import quoted
from granular.shared.registry import load_entry_point

if TYPE_CHECKING:
    import pandas
    import xarray

    from granular.run.trajectory import Trajectory

GROUP = "granular.observables"
"""Entry points by which an installed distribution offers observables."""


def per_frame(
    run: Trajectory, function: str | Callable[[Frame], Value], start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:  # fmt: skip
    """Values of a function of a frame, at every frame with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
    function : str or function of Frame
        A name of `OBSERVABLES`, or a function that returns a number, a number, a vector or a tensor
        for each grain, or a mapping of labels to such values.
    start, stop : float
        [s]

    Returns
    -------
    xarray.DataArray
        On ``frame``, then on ``label`` for a mapping, and on ``grain`` and the axes; with its unit
        if the function is an `observable`.

    Raises
    ------
    InputError
        If there is no such name or frame, or the function fails or returns something else.
    """
    import xarray

    if isinstance(function, str):
        function = find_observable(function)
    marked = observable_of(function)
    name = function.__name__ if marked is None else marked.name
    chosen = chosen_frames(run, start, stop)
    values = [_value(function, name, frame) for frame in frames(run, chosen)]
    labels = tuple(values[0]) if values and isinstance(values[0], Mapping) else None
    arrays = [
        np.asarray(one if labels is None else list(one.values()), dtype=np.float64)
        for one in values
    ]
    dims = _dimensions(arrays, name, run.scene.grains.count, labels is not None)
    data = run.dataset.isel(frame=chosen)
    coordinates: dict[str, Any] = {"frame_time": data["frame_time"]}
    if labels is not None:
        coordinates["label"] = list(labels)
    if "grain" in dims:
        known = ("grain", "species", "diameter")
        coordinates |= {one: data[one] for one in known if one in data.variables}
    return xarray.DataArray(
        np.array(arrays), dims=("frame", *dims), coords=coordinates,
        attrs={} if marked is None else marked.attributes,
    )  # fmt: skip


def _value(function: Callable[[Frame], Value], name: str, frame: Frame) -> Any:
    try:
        value = function(frame)
        return value if isinstance(value, Mapping) else np.asarray(value, dtype=np.float64)
    except GranularError:
        raise
    except Exception as error:
        raise InputError(
            f"observable {quoted(name)} fails at {frame.time:g} s: "
            f"{type(error).__name__}: {error}; mend its function"
        ) from error


def _dimensions(
    values: Sequence[np.ndarray], name: str, count: int, labelled: bool
) -> tuple[str, ...]:
    shapes = {value.shape[1:] if labelled else value.shape for value in values} or {()}
    known = {
        (): (), (count,): ("grain",), (count, 2): ("grain", "axis"),
        (count, 2, 2): ("grain", "row", "column"),
    }  # fmt: skip
    if len(shapes) > 1 or not shapes <= set(known):
        raise InputError(
            f"observable {quoted(name)} returns values of the shape "
            f"{', '.join(map(str, sorted(shapes)))}; give a number, one a grain ({count},), or "
            f"a vector a grain ({count}, 2)"
        )
    return (*(("label",) if labelled else ()), *known[shapes.pop()])


def frame_table(run: Trajectory, functions: Sequence[Callable[[Frame], Value]]) -> pandas.DataFrame:
    """Time [s] and observables of every frame; each column's name holds its unit.

    Values by label have a column each.

    Raises
    ------
    InputError
        If an observable cannot be computed, or has a value a grain.
    """
    import pandas

    columns = {"time [s]": run.dataset["frame_time"].values}
    for function in functions:
        values, marked = per_frame(run, function), observable_of(function)
        name, unit = (function.__name__, "1") if marked is None else (marked.name, marked.unit)
        if "grain" in values.dims:
            raise InputError(
                f"observable {quoted(name)} has a value a grain, which no table of frames "
                "holds; take granular.observables.per_frame in Python"
            )
        if "label" in values.dims:
            for label in values["label"].values:
                columns[f"{name}.{label} [{unit}]"] = values.sel(label=label).values
        else:
            columns[f"{name} [{unit}]"] = values.values
    return pandas.DataFrame(columns)


def find_observable(
    name: str, own: Mapping[str, Callable[[Frame], Value]] | None = None
) -> Callable[[Frame], Value]:
    """Observable of a name: the package's, a user's own, or an installed distribution's.

    Parameters
    ----------
    name : str
    own : mapping of str to function, optional
        The user's own by their names; see `granular.own.import_own`.

    Raises
    ------
    InputError
        If there is none, or the distribution's cannot be loaded.

    Examples
    --------
    >>> from granular.observables.over_frames import find_observable
    >>> find_observable("mean_distance").observable.unit
    'm'
    """
    every = {**OBSERVABLES, **(own or {})}
    if name in every:
        return every[name]
    found: Callable[[Frame], Value] | None = load_entry_point(GROUP, name, "observable")
    if observable_of(found) is not None and found is not None:
        return found
    if found is not None:
        raise InputError(f"observable {quoted(name)} is no granular Observable")
    raise InputError(
        f"{unknown(name, tuple(every), 'observable')}; one of your own comes by --import FILE, or "
        f"by an installed entry point of the group {GROUP!r}"
    )
