"""Observables by name, and their values at every frame of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.defects import count_defects
from granular.observables.forces import (
    compressive_forces,
    grain_pressures,
    grain_stresses,
    interaction_forces,
    relative_force_fluctuation,
)
from granular.observables.frame import (
    Frame,
    Value,
    frames,
    labelled_array,
    observable,
    observable_metadata,
    present_grain_mask,
    require_piston,
    select_frame_indices,
    species_names,
)
from granular.observables.motion import fluctuation_energies, kinetic_temperature
from granular.observables.packing import least_piston_distance, mean_pair_distance, packing_fraction
from granular.observables.voronoi import hexagon_regularity, polygon_fractions, voronoi_cells
from granular.shared.array_types import Float
from granular.shared.errors import GranularError, InputError, quote
from granular.shared.registry import Registry

if TYPE_CHECKING:
    import pandas
    import xarray

    from granular.run.trajectory import Trajectory


@observable("m", "mean distance between two grains", name="mean_distance")
def mean_grain_distance(frame: Frame) -> float:
    """Mean distance [m] between the centres of two grains, averaged over all pairs [D, eq. 2.1]."""
    return mean_pair_distance(frame.positions)


@observable("m", "distance of the piston from the nearest grain", name="piston_distance")
def nearest_grain_to_piston(frame: Frame) -> float:
    """Minimum distance [m] of a grain's centre from the piston, called delta in [D, eq. 4.29]."""
    return least_piston_distance(frame.positions, frame.piston_height)


@observable("m", "minimum distance of a grain's centre from the piston", name="species_piston_distance")
def nearest_grain_to_piston_by_species(frame: Frame) -> dict[str, float]:
    """Minimum distance [m] of a grain's centre from the piston, for each species [D, eq. 4.29]."""
    require_piston(frame.scene)
    return {
        name: least_piston_distance(frame.positions[frame.species == k], frame.piston_height)
        for k, name in enumerate(species_names(frame.scene))
    }


@observable("1", "packing fraction below the piston, or of a periodic cell", name="packing")
def frame_packing_fraction(frame: Frame) -> float:
    """Area of the grains divided by the area below the piston or of the periodic cell [D, eq. 2.2]."""
    present = present_grain_mask(frame.positions)
    height = frame.scene.cell.height or frame.piston_height
    return float(packing_fraction(frame.diameters[present], frame.scene.cell.width, height))


@observable("1", "mean of |psi_6| over the grains", name="hexatic_order")
def mean_local_psi6(frame: Frame) -> float:
    """Mean of |psi_6| over the grains with an interior Voronoi cell [D, eq. 4.28]."""
    return psi6(frame.positions)


@observable("1", "fraction of the interior cells", name="polygons")
def frame_polygon_fractions(frame: Frame) -> dict[str, float]:
    """Fractions of pentagons, hexagons, heptagons and others among the interior Voronoi cells [D, 4.2.4]."""
    return polygon_fractions(voronoi_cells(frame.positions)).by_name


@observable("1", "number of interior Voronoi cells", name="interior_cells")
def interior_cell_count(frame: Frame) -> float:
    """Count the Voronoi cells that lie entirely in the bounding box of the centres [D, 4.2.4]."""
    return float(voronoi_cells(frame.positions).interior.sum())


@observable("1", "regularity of the hexagons", name="regularity")
def mean_hexagon_regularity(frame: Frame) -> dict[str, float]:
    """Mean and standard deviation of the regularity of the hexagonal interior cells [D, eq. 4.25]."""
    values = hexagon_regularity(voronoi_cells(frame.positions))
    values = values[np.isfinite(values)]
    if not len(values):
        return {"mean": np.nan, "deviation": np.nan}
    return {"mean": float(values.mean()), "deviation": float(values.std())}


@observable("1", "number of defects", name="defects")
def defect_counts(frame: Frame) -> dict[str, float]:
    """Count disclinations, dislocations and unpaired disclinations of a frame."""
    return count_defects(voronoi_cells(frame.positions))


@observable("J", "kinetic temperature of the bed", name="temperature")
def granular_temperature(frame: Frame) -> float:
    """Mean kinetic energy [J] of the velocity fluctuations of a grain; see `kinetic_temperature`."""
    return kinetic_temperature(frame.velocities, frame.masses)


@observable("J", "kinetic temperature of the species", name="species_temperature")
def granular_temperature_by_species(frame: Frame) -> dict[str, float]:
    """Mean kinetic energy [J] of a grain of each species, relative to the bed's centre of mass."""
    energies = fluctuation_energies(frame.velocities, frame.masses)
    means = {}
    for k, name in enumerate(species_names(frame.scene)):
        known = energies[(frame.species == k) & np.isfinite(energies)]
        means[name] = float(known.mean()) if len(known) else np.nan
    return means


@observable("N", "force of grains and walls on the grain", name="interaction_force")
def grain_interaction_force(frame: Frame) -> Float[np.ndarray, "n 2"]:
    """Force [N] on each grain from the other grains and the walls; see `interaction_forces`."""
    return interaction_forces(frame)


@observable("1", "relative fluctuation of the force on the grain", name="force_fluctuation")
def interior_force_fluctuation(frame: Frame) -> Float[np.ndarray, "n"]:
    """Relative fluctuation of the force on each grain with an interior cell [D, eq. 4.35, Fig. 4.24]."""
    sizes = np.linalg.norm(interaction_forces(frame), axis=1)
    inner = voronoi_cells(frame.positions).interior
    return relative_force_fluctuation(np.where(inner, sizes, np.nan), frame.species)


@observable("N", "compressive force on the grain", name="compressive_force")
def grain_compressive_force(frame: Frame) -> Float[np.ndarray, "n"]:
    """Sum of the magnitudes [N] of all forces of grains and walls on each grain; see `compressive_forces`."""
    return compressive_forces(frame.scene, frame.positions, frame.heights)


@observable("N/m", "stress of the grain, positive for compression")
def grain_stress(frame: Frame) -> Float[np.ndarray, "n 2 2"]:
    """Virial stress tensor [N/m] of each grain in its Voronoi cell; see `grain_stresses`."""
    return grain_stresses(frame.scene, frame.positions, frame.heights)


@observable("N/m", "pressure of the grain")
def grain_pressure(frame: Frame) -> Float[np.ndarray, "n"]:
    """Pressure [N/m] of each grain: half the trace of its virial stress tensor; see `grain_pressures`."""
    return grain_pressures(frame.scene, frame.positions, frame.heights)


OBSERVABLES = Registry[Callable[[Frame], Value]](
    "observable",
    "granular.observables",
    {
        function.observable.name: function
        for function in list(globals().values())
        if observable_metadata(function) is not None and function.__module__ == __name__
    },
    lambda _, function: observable_metadata(function) is not None,
    "a granular.observables.observable",
    from_files=True,
)
"""Observables by name."""


def per_frame(
    run: Trajectory, function: str | Callable[[Frame], Value], start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """Evaluate a function of a frame at every frame with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    function : str or function of Frame
        A name in `OBSERVABLES`, or a function. The function must return one number; or, for each grain, a
        number (n,), a vector (n, 2) or a tensor (n, 2, 2). It may also return a mapping of labels to such
        values, with the same labels and shapes in every frame.
    start, stop : float
        First and last time of the frames [s].

    Returns
    -------
    xarray.DataArray
        Values with the dimension ``frame``; ``label`` for a mapping; ``grain`` for values of each grain; also
        ``axis`` for vectors, or ``row`` and ``column`` for tensors. Unit and meaning are attached if the
        function is an `observable`. NaN if the function returns NaN, for example for grains that have left
        the cell.

    Raises
    ------
    InputError
        If the name is unknown or cannot be loaded, no frame lies in the range, or the function fails or
        returns a value of another shape.
    ValueError, TypeError or AttributeError
        If values of a mapping are not numbers or differ in shape, or the function returns a mapping for only
        some frames. Labels are taken from the first frame and not checked in later frames.
    """
    if isinstance(function, str):
        function = OBSERVABLES.find(function)
    marked = observable_metadata(function)
    name = getattr(function, "__name__", type(function).__name__) if marked is None else marked.name
    chosen = select_frame_indices(run, start, stop)
    values = [_evaluate_on_frame(function, name, frame) for frame in frames(run, chosen)]
    labels = tuple(values[0]) if values and isinstance(values[0], Mapping) else None
    arrays = [
        np.asarray(value if labels is None else list(value.values()), dtype=np.float64) for value in values
    ]
    dims = _dimension_names_of_values(arrays, name, run.scene.grains.count, labels is not None)
    data = run.dataset.isel(frame=chosen)
    coordinates: dict[str, Any] = {"frame_time": data["frame_time"]}
    if labels is not None:
        coordinates["label"] = list(labels)
    if "grain" in dims:
        known = ("grain", "species", "diameter")
        coordinates |= {name: data[name] for name in known if name in data.variables}
    return labelled_array(np.array(arrays), ("frame", *dims), coordinates, marked)


def _evaluate_on_frame(function: Callable[[Frame], Value], name: str, frame: Frame) -> Any:
    try:
        value = function(frame)
        return value if isinstance(value, Mapping) else np.asarray(value, dtype=np.float64)
    except GranularError:
        raise
    except Exception as error:
        raise InputError(
            f"observable {quote(name)} fails at {frame.time:g} s: "
            f"{type(error).__name__}: {error}; correct its function"
        ) from error


def _dimension_names_of_values(
    values: Sequence[np.ndarray], name: str, count: int, labelled: bool
) -> tuple[str, ...]:
    shapes = {value.shape[1:] if labelled else value.shape for value in values} or {()}
    known = {
        (): (),
        (count,): ("grain",),
        (count, 2): ("grain", "axis"),
        (count, 2, 2): ("grain", "row", "column"),
    }
    if len(shapes) > 1 or not shapes <= set(known):
        raise InputError(
            f"observable {quote(name)} returns values of the shape "
            f"{', '.join(map(str, sorted(shapes)))}; return one number, or for each grain a number "
            f"({count},), a vector ({count}, 2) or a tensor ({count}, 2, 2)"
        )
    return (*(("label",) if labelled else ()), *known[shapes.pop()])


def observables_table(run: Trajectory, functions: Sequence[Callable[[Frame], Value]]) -> pandas.DataFrame:
    """Tabulate observables of all frames of a run, one row per frame; column names include units."""
    import pandas

    columns = {"time [s]": run.dataset["frame_time"].values}
    for function in functions:
        values, marked = per_frame(run, function), observable_metadata(function)
        name, unit = (function.__name__, "1") if marked is None else (marked.name, marked.unit)
        if "grain" in values.dims:
            raise InputError(
                f"observable {quote(name)} has a value for each grain, but the table has one row per frame; "
                "use granular.observables.per_frame in Python"
            )
        if "label" in values.dims:
            for label in values["label"].values:
                columns[f"{name}.{label} [{unit}]"] = values.sel(label=label).values
        else:
            columns[f"{name} [{unit}]"] = values.values
    return pandas.DataFrame(columns)
