"""Observables of one's own: a function of a frame, with its unit, into a run's dataset.

>>> @observable("N", "greatest force on a grain")
... def greatest_force(frame):
...     return np.nanmax(np.linalg.norm(frame.forces, axis=1))
>>> data = with_observables(run, greatest_force)
>>> data["greatest_force"].plot()
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.observables.forces import grain_masses
from granular.observables.frames import frame_array
from granular.scene.scene import Scene
from granular.schema.units import unit_size
from granular.shared.errors import InputError
from granular.shared.messages import quoted

if TYPE_CHECKING:
    import pandas
    import xarray

    from granular.run.trajectory import Trajectory


class Frame(NamedTuple):
    """A moment of a run, in SI; values of grains that have left the cell are NaN.

    Attributes
    ----------
    scene : Scene
    time : float
        [s]
    positions, velocities, forces : float (n, 2)
        [m], [m/s], [N]
    piston_height : float
        [m]; NaN without a piston.
    species : int (n,)
    diameters, masses : float (n,)
        [m], [kg]
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


Value = float | np.ndarray
"""A number, one a grain (n,), or a vector a grain (n, 2)."""


@dataclasses.dataclass(frozen=True)
class Observable:
    """A function of a frame, with a name and a unit.

    Attributes
    ----------
    function : callable
        Of a `Frame`; returns a number, one a grain, or a vector a grain.
    name : str
        Of its variable in the dataset.
    unit : str
        In which the function returns its value, such as ``"N"`` or ``"mm/s"``; ``"1"`` for none.
    meaning : str
    """

    function: Callable[[Frame], Value]
    name: str
    unit: str
    meaning: str = ""

    def __call__(self, run: Trajectory) -> xarray.DataArray:
        """Its value at every frame of a run.

        Raises
        ------
        InputError
            If the function fails, or returns something else than numbers of one shape.
        """
        values = [self._of(frame) for frame in frames(run)]
        shapes = {value.shape for value in values} or {()}
        count = run.scene.grains.count
        dims = {(): (), (count,): ("grain",), (count, 2): ("grain", "axis")}
        if len(shapes) > 1 or not shapes <= set(dims):
            raise InputError(
                f"observable {quoted(self.name)} returns values of the shape "
                f"{', '.join(map(str, sorted(shapes)))}; give a number, one a grain ({count},), or "
                f"a vector a grain ({count}, 2)"
            )
        return frame_array(
            run, np.array(values), self.unit, self.meaning, ("frame", *dims[shapes.pop()])
        )

    def _of(self, frame: Frame) -> np.ndarray:
        try:
            return np.asarray(self.function(frame), dtype=np.float64)
        except Exception as error:
            raise InputError(
                f"observable {quoted(self.name)} fails at {frame.time:g} s: "
                f"{type(error).__name__}: {error}; mend its function"
            ) from error


def observable(
    unit: str, meaning: str = "", name: str | None = None
) -> Callable[[Callable[[Frame], Value]], Observable]:
    """Make a function of a frame an observable.

    Parameters
    ----------
    unit : str
        In which it returns its value; ``"1"`` for none.
    meaning : str
        In words, for the axis of a plot.
    name : str, optional
        Of its variable in the dataset; the function's without.

    Raises
    ------
    InputError
        If the unit cannot be read, or the name is no word.
    """
    if unit != "1":
        unit_size(unit)

    def made(function: Callable[[Frame], Value]) -> Observable:
        called = function.__name__ if name is None else name
        if not called.isidentifier():
            raise InputError(f"observable {quoted(called)}; give a name such as 'greatest_force'")
        return Observable(function, called, unit, meaning)

    return made


def frames(run: Trajectory) -> Iterator[Frame]:
    """The frames of a run."""
    data, masses = run.dataset, grain_masses(run)
    heights = None if run.scene.piston is None else data["frame_height"].values
    fixed: dict[str, Any] = {
        "species": data["species"].values, "diameters": data["diameter"].values, "masses": masses,
    }  # fmt: skip
    places = run.scene.cell.inside(data["position"].values)
    for k, time in enumerate(data["frame_time"].values):
        yield Frame(
            run.scene, float(time), places[k], data["velocity"].values[k],
            data["force"].values[k], float("nan") if heights is None else float(heights[k]),
            **fixed,
        )  # fmt: skip


def with_observables(run: Trajectory, *observables: Observable) -> xarray.Dataset:
    """The dataset of a run, and observables in it as variables of their names.

    Raises
    ------
    InputError
        If a name is taken, or an observable cannot be computed.
    """
    data = run.dataset
    for one in observables:
        if not isinstance(one, Observable):
            raise InputError(f"{quoted(one)} is no observable; decorate it by @observable(unit)")
        if one.name in data:
            raise InputError(
                f"the run has a variable {quoted(one.name)} already; give name= to the observable"
            )
        data = data.assign({one.name: one(run)})
    return data


def observed_table(run: Trajectory, observables: Sequence[Observable]) -> pandas.DataFrame:
    """Time [s] and observables of every frame; each column's name holds its unit.

    Raises
    ------
    InputError
        If an observable cannot be computed, or has a value a grain.
    """
    import pandas

    columns = {"time [s]": run.dataset["frame_time"].values}
    for one in observables:
        found = one(run)
        if found.dims != ("frame",):
            raise InputError(
                f"observable {quoted(one.name)} has a value a grain, which no table of frames "
                "holds; take granular.observables.with_observables in Python"
            )
        columns[f"{one.name} [{one.unit}]"] = found.values
    return pandas.DataFrame(columns)
