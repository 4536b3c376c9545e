"""Result of a run: labelled data, results of the stages, and the piston's record."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from granular.effects.shaking import Shaking
from granular.methods import Method, resolve_method
from granular.protocol import Stage
from granular.protocol.stages import Lift
from granular.records.options import RecordSource
from granular.records.record import PistonRecord
from granular.run.run_directory import Manifest
from granular.run.zarr_arrays import ZarrArray, ZarrGroupMetadata
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.array_types import Float, Int
from granular.shared.blocks import Printout
from granular.shared.errors import RecordError, unknown_word_message

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MIN_TIME_DIFFERENCE = 1e-18
"""Minimum shift [s] by which two equal times are made different."""


@dataclasses.dataclass(frozen=True)
class StageResult:
    """Times and outcome of a stage in a run.

    Attributes
    ----------
    name : str
        Name of the stage.
    start, end : float
        Times of start and end since the start of the run [s].
    reason : str
        Reason for the end: ``"duration"``, ``"rest"``, ``"force"``, or ``"cut"`` if the run ended during the
        stage.
    height : float
        Piston height at the end [m]; for a stage that ends at rest, the middle of the range of heights over
        the time window in which rest was detected.
    spread : float
        Range of heights in this time window [m]; 0 for stages that do not end at rest.
    """

    name: str
    start: float
    end: float
    reason: str
    height: float
    spread: float


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """Result of a run.

    Attributes
    ----------
    scene : Scene
        Scene that was run.
    dataset : xarray.Dataset
        Scalars on ``time`` [s], grain fields on (``frame``, ``grain``, ``axis``), all in SI with
        ``attrs["units"]``; scene, settings and versions in the attributes. Times increase strictly: a
        jump of the piston has two records, and the second gets the next floating-point number as its time.
        ``stage`` is the index of each record's stage in the protocol.
    stages : tuple of StageResult
        Stages that began; the last may be incomplete.
    complete : bool
        True if the end of the protocol or ``t_end`` was reached.
    path : Path or None
        The run directory; None for a run in memory.
    """

    scene: Scene
    dataset: xarray.Dataset
    stages: tuple[StageResult, ...]
    complete: bool
    path: Path | None = None

    def __repr__(self) -> str:
        sizes = self.dataset.sizes
        stages = ", ".join(f"{stage.name} to {stage.end:.4g} s ({stage.reason})" for stage in self.stages)
        records, frames, grains = (sizes[name] for name in ("time", "frame", "grain"))
        return (
            f"Trajectory of scene {self.scene.name!r}, {'complete' if self.complete else 'cut'}\n"
            f"  stages: {stages or 'none ended'}\n"
            f"  dataset: {records} records, {frames} frames of {grains} grains"
            + ("" if self.path is None else f"\n  kept in {self.path}")
        )

    def _repr_html_(self) -> str:
        from granular.shared.html_pages import blocks_html

        return blocks_html([Printout(repr(self))]) + self.dataset._repr_html_()

    def _repr_latex_(self) -> str:
        from granular.shared.blocks import latex_lines

        return latex_lines(repr(self))

    @property
    def literature(self) -> tuple[str, ...]:
        """References to the papers behind the scene and the method, a tuple of str; see `granular.cite`."""
        return (*self.scene.literature, *self.method.literature)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot the piston's height [mm] against time [s]; without a piston the grains' kinetic energy [J].

        Dotted lines mark the beginning of the second and later stages.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; new axes by default.

        Returns
        -------
        Axes
            Axes with the plot.
        """
        from granular.shared.plotting import axes_or_new

        ax = axes_or_new(ax)
        name = "piston_height" if "piston_height" in self.dataset else "kinetic_energy"
        unit, factor = ("mm", 1e3) if name == "piston_height" else ("J", 1.0)
        ax.plot(self.dataset["time"], factor * self.dataset[name])
        for stage in self.stages[1:]:
            ax.axvline(stage.start, color="0.6", linewidth=0.8, linestyle=":")
        ax.set(xlabel="time [s]", ylabel=f"{name.replace('_', ' ')} [{unit}]")
        return ax

    def stage(self, name: str) -> StageResult:
        """Return the result of a stage by its name.

        Parameters
        ----------
        name : str
            Name of a stage of the protocol.

        Returns
        -------
        StageResult
            Times, reason for the end, and piston height.

        Raises
        ------
        RecordError
            If the run has no such stage.
        """
        for stage in self.stages:
            if stage.name == name:
                return stage
        raise RecordError(unknown_word_message(name, tuple(stage.name for stage in self.stages), "stage"))

    def piston(self, stage: str | None = None) -> PistonRecord:
        """Return the motion of the piston, with its drive as further columns.

        Heights are relative to the cell, which may move. The further columns are

        - ``base_height`` [m], ``base_velocity`` [m/s] and ``base_acceleration`` [m/s^2] for a shaken cell;
        - only ``base_acceleration`` for a host (the structure that carries the damper) with
          ``mount = "base"``;
        - ``outer_force`` [N] for a piston under an external force.

        A piston with a prescribed path has no further columns.

        Parameters
        ----------
        stage : str, optional
            Name of a stage. Default: the stage in the scene's ``output.record``, or else the complete run.

        Returns
        -------
        PistonRecord
            Times since the start of the run [s], heights [m], velocities [m/s] and upward forces of the
            grains [N]. If the piston jumps, only the values after the jump are kept.

        Raises
        ------
        RecordError
            If the scene has no piston, the run has not reached the stage, or the stage has fewer than two
            records.
        """
        data, effects = self.dataset, self.scene.effects
        if "piston_height" not in data:
            raise RecordError(f"scene {self.scene.name!r} has no piston whose motion could be recorded")
        name = stage or self.scene.output.record
        chosen = slice(None) if name is None else self._records_of_stage(name)
        time = restore_equal_times(data["time"].values)[chosen]
        # At a jump of the piston the same time occurs twice: keep the later record.
        last = np.append(np.diff(time) > 0.0, True)
        recorded = [name for name in ("height", "velocity", "force") if f"piston_{name}" in data]
        columns = {name: data[f"piston_{name}"].values[chosen][last] for name in recorded}
        indices = np.asarray(data["stage"].values[chosen][last])
        if name is not None:  # the first of its records ends the stage before
            indices = np.full_like(indices, self._stage_index(name))
        time, protocol = time[last], self.scene.protocol
        shaking, host = effects.shaking, effects.host
        drive = {} if shaking is None else shaken_base_motion(shaking, time)
        if any(protocol[index].has_outer_force for index in np.unique(indices).astype(int)):
            starts = [stage.start for stage in self.stages]
            drive["outer_force"] = outer_force_on_free_piston(protocol, starts, indices, time)
        if host is not None and host.mount == "base" and "base_acceleration" in data:
            drive["base_acceleration"] = data["base_acceleration"].values[chosen][last]
        source = _source_of_scene(self.scene, name)
        return PistonRecord(time=time, **columns, extra=drive, source=source)

    def _stage_index(self, name: str) -> int:
        return [stage.name for stage in self.scene.protocol].index(name)

    def _records_of_stage(self, name: str) -> slice:
        """Return the records of a stage, from the last record of the previous stage on."""
        stage = self.stage(name)
        inside = np.flatnonzero(self.dataset["stage"].values == self._stage_index(name))
        times = restore_equal_times(self.dataset["time"].values)
        first = int(inside[0]) if len(inside) else len(times)
        if first > 0 and times[first - 1] == stage.start:
            first -= 1
        return slice(first, int(inside[-1]) + 1 if len(inside) else first + 1)

    @property
    def scalars(self) -> xarray.Dataset:
        """Variables that depend only on ``time`` [s], as an xarray Dataset in SI."""
        return self.dataset.drop_dims(["frame", "grain", "axis"])

    def settings(self) -> dict[str, Any]:
        """Return the method, steps, versions and timings of the run.

        Returns
        -------
        dict
            Plain data by name, such as ``method``, ``dt`` (as requested), ``steps``, ``versions``,
            ``ledger_residual`` (largest residual of the energy balance, relative to the energy turned over),
            and ``seconds`` and ``compile_seconds`` [s].
        """
        return dict(json.loads(self.dataset.attrs["settings"]))

    @property
    def method(self) -> Method:
        """Integration method of the run; its name or table is in `settings`."""
        return resolve_method(self.settings()["method"])


def load_trajectory(path: str | Path) -> Trajectory:
    """Load a run from its directory, also an unfinished or interrupted one.

    Parameters
    ----------
    path : str or Path
        Directory of the run.

    Returns
    -------
    Trajectory
        The run, whose data are read on access.

    Raises
    ------
    StoreError
        If the directory holds no run, or one of its files is missing or has changed since the run wrote it.
        Recorded data are verified on access, so reading the dataset may also raise this error.
    SceneError
        If the scene uses a custom effect, stage or law that was not imported.
    """
    from granular.run.run_directory import SCENE, SETTINGS, read_checkpoint_and_manifest, read_verified_files
    from granular.run.zarr_arrays import GROUP, ZarrGroupMetadata

    path = Path(path)
    checkpoint, manifest = read_checkpoint_and_manifest(path)
    files = read_verified_files(path, manifest)
    data = open_lazy_dataset(path, ZarrGroupMetadata(files[GROUP]), manifest)
    outcome = json.loads(str(checkpoint["outcome"]))
    return make_trajectory(load_scene(path / SCENE), data, json.loads(files[SETTINGS]), outcome, path)


def make_trajectory(
    scene: Scene, data: xarray.Dataset, settings: dict[str, Any], outcome: dict[str, Any], path: Path | None
) -> Trajectory:
    """Make a trajectory from a run's data, with coordinates and attributes."""
    species = scene.grains.species_indices()
    data = data.assign_coords(
        time=("time", separate_equal_times(data["time"].values), data["time"].attrs),
        frame=("frame", np.arange(data.sizes["frame"]), {"long_name": "frame", "units": "1"}),
        grain=np.arange(scene.grains.count),
        axis=["x", "y"],
        species=("grain", species, {"long_name": "species of the grain", "units": "1"}),
        diameter=("grain", scene.grains.diameters(), {"long_name": "diameter", "units": "m"}),
    )
    if scene.effects.walls is not None and scene.effects.walls.has_gap:
        data = data.assign(departure_variables(outcome.get("departures", [])))
    data = data.set_coords([name for name in ("frame_time", "stage") if name in data])
    data.attrs = {
        "title": f"scene {scene.name}",
        "units": "SI",
        "scene": scene.to_toml(),
        "settings": json.dumps({**settings, **outcome["figures"]}),
        "stages": json.dumps(outcome["stages"]),
        "complete": int(outcome["complete"]),
    }
    stages = tuple(StageResult(**stage) for stage in outcome["stages"])
    return Trajectory(scene, data, stages, outcome["complete"], path)


def piston_heights_in_frames(scene: Scene, data: xarray.Dataset) -> Float[np.ndarray, "f p"]:
    """Return the heights [m] of the piston (0 without one) and of further pistons in each frame."""
    pistons = () if scene.effects.host is None else scene.effects.host.pistons
    times = data["frame_time"].values, data["time"].values
    heights = [np.interp(*times, data[f"{other.name}_displacement"].values) for other in pistons]
    first = 0.0 * times[0] if scene.piston is None else data["frame_height"].values
    return np.stack([first, *heights], axis=1)


def departure_variables(departures: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Make dataset variables of index, time [s] and position [m] of the grains that have left."""
    table = np.array(departures, dtype=float).reshape(-1, 4)
    variables: dict[str, tuple[Any, np.ndarray, str, str]] = {
        "departure_grain": ("departure", table[:, 0].astype(int), "1", "grain that left"),
        "departure_time": ("departure", table[:, 1], "s", "time at which the grain had left the cell"),
        "departure_position": (
            ("departure", "axis"),
            table[:, 2:],
            "m",
            "position at which the grain left the cell",
        ),
    }
    return {
        name: (dims, values, {"units": unit, "long_name": meaning})
        for name, (dims, values, unit, meaning) in variables.items()
    }


def separate_equal_times(times: Float[np.ndarray, "r"]) -> Float[np.ndarray, "r"]:
    """Shift the later of two equal times [s], so that times increase strictly."""
    # At a jump of the piston two records have the same time. Labelled data need increasing times: the later
    # record gets the next double, about 1e-15 s later.
    result = np.array(times, dtype=np.float64)
    for k in np.flatnonzero(np.diff(result) <= 0.0):
        result[k + 1] = result[k] + _min_time_difference(result[k])
    return result


def restore_equal_times(times: Float[np.ndarray, "r"]) -> Float[np.ndarray, "r"]:
    """Undo `separate_equal_times`: give the two records of a jump the same time [s] again."""
    result = np.array(times, dtype=np.float64)
    for k in np.flatnonzero(np.diff(result) <= 2.0 * _min_time_difference(result[:-1])):
        result[k + 1] = result[k]
    return result


def _min_time_difference(times: np.ndarray) -> np.ndarray:
    return np.maximum(np.spacing(times), MIN_TIME_DIFFERENCE)


def shaken_base_motion(shaking: Shaking, time: Float[np.ndarray, "n"]) -> dict[str, np.ndarray]:
    """Return a dict of height, velocity and acceleration of a shaken cell at given times [s], in SI."""
    # Heights of the piston are relative to the moving cell: the law is z'' + ... = g0 - base_acceleration.
    omega = 2.0 * math.pi * shaking.frequency
    reach = shaking.amplitude * math.sin(shaking.angle)
    height = reach * np.sin(omega * time)
    return {
        "base_height": height,
        "base_velocity": reach * omega * np.cos(omega * time),
        "base_acceleration": -(omega**2) * height,
    }


def outer_force_on_free_piston(
    protocol: Sequence[Stage],
    starts: Sequence[float],
    stage: Int[np.ndarray, "n"],
    time: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n"]:
    """Return the upward external force [N] on the free piston at each time [s]; 0 in stages without force."""
    force = np.zeros(len(time))
    for index, (segment, start) in enumerate(zip(protocol, starts, strict=False)):
        if segment.has_outer_force:
            inside = stage == index
            force[inside] = segment.outer_force(np.maximum(time[inside] - start, 0.0))
    return force


def _source_of_scene(scene: Scene, stage: str | None) -> RecordSource:
    """Describe the source of a simulated record: the bed, its piston and the recorded stage."""
    recorded = "the whole run" if stage is None else f"stage {stage!r}"
    for before, item in itertools.pairwise(scene.protocol):
        if item.name == stage and isinstance(before, Lift):
            recorded = f"free decay after a {1e3 * before.by:.3g} mm lift"
    mass = None if scene.piston is None else scene.piston.mass  # a driven piston may have none
    piston = "" if mass is None else f"piston {mass:.4g} kg, "
    return RecordSource(scene.name, scene=f"{scene.grains.count} magnets, {piston}{recorded}")


def open_lazy_dataset(path: Path, metadata: ZarrGroupMetadata, manifest: Manifest) -> xarray.Dataset:
    """Open a run's arrays up to the last checkpoint; chunks are read on access."""
    variables = {}
    for name, plain in sorted(metadata.arrays.items()):
        array = ZarrArray(path, name, plain)
        variables[name] = (array.dims, LazilyIndexedArray(_LazyZarrArray(array, manifest)), array.attributes)
    return xarray.Dataset(variables)


class _LazyZarrArray(BackendArray):
    """Array of a run up to the last checkpoint, which xarray reads on access."""

    def __init__(self, array: ZarrArray, manifest: Manifest) -> None:
        self._array, self._manifest = array, manifest
        self.shape = (manifest.lengths[array.dims[0]], *array.rest)
        self.dtype = array.dtype

    def __getitem__(self, key: Any) -> np.ndarray:
        values: np.ndarray = explicit_indexing_adapter(
            key, self.shape, IndexingSupport.OUTER, self._read_entries
        )
        return values

    def _read_entries(self, key: tuple[Any, ...]) -> np.ndarray:
        """Read the entries that an integer, a slice or an array of integers selects along each dimension."""
        entries = np.arange(self.shape[0])[key[0]]
        rows = np.atleast_1d(entries)
        borders = np.flatnonzero(np.diff(rows // self._array.depth)) + 1
        parts = [self._entries_of_chunk(part, key[1:]) for part in np.split(rows, borders) if part.size]
        values = np.concatenate(parts) if parts else self._entries_of_chunk(rows, key[1:])
        return values if entries.ndim else values[0]

    def _entries_of_chunk(self, rows: np.ndarray, rest: tuple[Any, ...]) -> np.ndarray:
        """Read the given rows of one chunk, at the given indices along the other dimensions."""
        if rows.size and 0 not in self.shape:
            index = int(rows[0]) // self._array.depth
            values = self._array.read_chunk(index, self._manifest)[rows - index * self._array.depth]
        else:
            values = np.empty((len(rows), *self.shape[1:]), dtype=self.dtype)
        for axis, chosen in reversed(list(enumerate(rest, start=1))):
            values = values[(slice(None),) * axis + (chosen,)]
        return values
