"""Load records from their sources: a scene to simulate, a run, a CSV or Parquet file, or an object."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.records.options import ReadOptions, is_record_description, read_described_path_and_options
from granular.records.record import PistonRecord
from granular.shared.errors import (
    InputError,
    RecordError,
    RecordWarning,
    StoreError,
    one_line,
    quote,
    sanitize,
)
from reduced_models.records.free_motion import find_free_motion, find_free_motions

if TYPE_CHECKING:
    from granular.run.plan import Plan
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

DEFAULT_METHOD = "stormer-verlet"


def load_record(source: Scene | Trajectory | PistonRecord, progress: bool) -> PistonRecord:
    """Load the record of a source; a scene is simulated first."""
    opened = open_and_check_source(source)
    if isinstance(opened, PistonRecord):
        return opened
    from granular.run.simulation import simulate
    from granular.run.trajectory import Trajectory

    run = opened if isinstance(opened, Trajectory) else simulate(opened, progress=progress)
    return run.piston()


def open_and_check_source(
    source: str | Path | Scene | Plan | Trajectory | PistonRecord,
) -> Scene | Plan | Trajectory | PistonRecord:
    """Open a source; check that it contains a piston's record, or that its simulation will give one."""
    result = open_source(source) if isinstance(source, str | Path) else source
    if isinstance(result, PistonRecord):  # without importing the simulation
        return result
    from granular.run.plan import Plan
    from granular.scene.scene import Scene

    if isinstance(result, Scene | Plan):
        scene = result.scene if isinstance(result, Plan) else result
        if scene.piston is None:
            raise InputError(
                f"scene {quote(scene.name)} has no piston, so there is nothing to identify; "
                "choose a scene with a piston"
            )
        return result
    if not hasattr(result, "settings"):
        raise InputError(f"a {type(result).__name__} cannot be identified; give a scene, plan, run or record")
    missing = {"dt", "method", "steps"} - set(result.settings())
    if missing:
        raise StoreError(
            f"the settings of the run in {result.path} do not contain {', '.join(sorted(missing))}; "
            "run the scene again"
        )
    return result


def make_directory(out: str | Path) -> Path:
    """Return a directory to write to; create it if it does not exist."""
    path = Path(out)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise StoreError(f"{shortened_path_text(path)} is a file; give a directory to write to") from None
    except OSError as error:
        raise StoreError(
            f"{shortened_path_text(path)} cannot be created: {error.strerror}; give another directory"
        ) from None
    if not os.access(path, os.W_OK):
        raise StoreError(f"{shortened_path_text(path)} cannot be written to; give another directory")
    return path


def shortened_path_text(path: Path) -> str:
    """Return a path as a text for messages, shortened and without control characters."""
    return sanitize(path, 80)


def read_record(path: str | Path, units: Mapping[str, str] | None = None, **said: Any) -> PistonRecord:
    """Read the motion in a file, as `PistonRecord.from_file` does, from its release on.

    Lost or clipped samples, the hold before the release, further releases, the motion after a knock,
    and an end that is only noise are omitted (see `reduced_models.records.free_motion`).
    ``release=2`` selects the second release. If times (``between``) are given, here or in the
    ``record.toml``, the record is cut at these times only. A record of the force on a prescribed
    stroke is not cut at all.

    Parameters
    ----------
    path : str or Path
        File to read, or a ``record.toml`` that describes one.
    units : mapping of str to str, optional
        Units of the columns by their roles or names; they replace the units in the file.
    **said
        Reading options: ``columns``, ``decimal``, ``skip``, ``sheet``, ``flip``, ``between``,
        ``scale``, ``zero``, ``calibration``, ``rate``, ``sort`` and ``release``, the fields of
        `granular.records.options.ReadOptions`.

    Returns
    -------
    PistonRecord
        Motion in SI units: times [s] and heights [m], or angles [rad], (n,) each, and further columns.

    Raises
    ------
    RecordError
        If the file cannot be read as a record, an option is unknown or out of its range, a release is
        given together with times, the file does not have this release, or ``release="all"`` is given
        (use `read_releases`).
    InputError
        If a ``.toml`` file is not valid TOML.

    Warns
    -----
    RecordWarning
        For each guess, repair and cut.
    """
    record = PistonRecord.from_file(path, units, **said)
    options = options_with_description(Path(path), ReadOptions(**said))
    if record.measured == "force":
        return record
    if options.between is not None:
        return dataclasses.replace(record, complete=True)
    return _with_warnings_as_notes(lambda: [find_free_motion(record, options.release)])[0]


def read_releases(
    path: str | Path, units: Mapping[str, str] | None = None, **said: Any
) -> list[PistonRecord]:
    """Read the motions in a file with several releases, to fit them together or one by one.

    Each motion is cut as by `read_record`. If times (``between``) are given, the part of the record between
    them is also divided into motions. A record of a force on a prescribed stroke is returned uncut, as a list
    of one record.

    Parameters
    ----------
    path : str or Path
        File as for `read_record`.
    units : mapping of str to str, optional
        Units of the columns by their roles or names, which replace the units in the file.
    **said : Any
        Further options of `read_record`; ``release`` is checked and then ignored.

    Returns
    -------
    list of PistonRecord
        One record for each release, in SI units: times [s] and heights [m], or angles [rad], (n,)
        each, and further columns.

    Raises
    ------
    RecordError
        If the file cannot be read as a record, an option is unknown or out of its range, or a release
        is given together with times.
    InputError
        If a ``.toml`` file is not valid TOML.

    Warns
    -----
    RecordWarning
        For each guess, repair and omission.
    """
    record = PistonRecord.from_file(path, units, **said)
    if record.measured == "force":
        return [record]
    return _with_warnings_as_notes(lambda: find_free_motions(record))


def _with_warnings_as_notes(find: Callable[[], list[PistonRecord]]) -> list[PistonRecord]:
    """Return the motions that a function finds, with the function's warnings as notes in their sources."""
    with warnings.catch_warnings(record=True, action="always", category=RecordWarning) as caught:
        motions = find()
    for warning in caught:
        warnings.warn(warning.message, stacklevel=3)
    notes = tuple(str(item.message) for item in caught if issubclass(item.category, RecordWarning))
    return [
        motion
        if motion.source is None
        else dataclasses.replace(
            motion, source=dataclasses.replace(motion.source, notes=(*motion.source.notes, *notes))
        )
        for motion in motions
    ]


def describe_record(record: PistonRecord, period: float | None = None) -> list[str]:
    """Describe a record and list its notes; with ``period`` [s], also give the number of cycles."""
    duration = float(record.time[-1] - record.time[0])
    cycles = f" ({duration / period:.0f} cycles)" if period and duration > period else ""
    source = record.source
    if source is not None and source.scene:
        return [f"{sanitize(source.name)}: {source.scene}, {duration:.2g} s{cycles}"]
    quantity = record.coordinate if record.measured == "height" else record.measured
    rate = f"{(len(record) - 1) / duration:.4g}"
    title = f"{quantity}, {len(record)} samples at {rate} Hz, {duration:.3g} s{cycles}"
    if source is None:
        return [f"record: {title}"]
    notes = [f"calibration: {source.calibration}"] * bool(source.calibration) + list(source.notes)
    return [f"{sanitize(source.name) or 'record'}: {title}", *map(one_line, notes)]


def options_with_description(path: Path, options: ReadOptions) -> ReadOptions:
    """Return reading options, merged with the options in the file if the path is a description."""
    return read_described_path_and_options(path)[1].merge(options) if is_record_description(path) else options


def open_source(source: str | Path, options: ReadOptions | None = None) -> Scene | Trajectory | PistonRecord:
    """Return the scene, the run, or the motion in a record's file, that a path or name refers to."""
    path, plain = Path(source), {} if options is None else options.to_plain()
    try:
        if is_record_file(path) or not (path.is_dir() or path.suffix in ("", ".toml")):
            return read_record(path, **plain)
        if plain:
            raise InputError(
                f"{', '.join(plain)} can be given only for the file of a record, but "
                f"{shortened_path_text(path)} is not one; remove the option"
            )
        from granular.run.run_directory import is_run_directory
        from granular.run.trajectory import load_trajectory
        from granular.scene.named_scenes import load_scene

        if is_run_directory(path):
            return load_trajectory(path)
        return load_scene(source)
    except OSError as error:
        raise InputError(
            f"{shortened_path_text(path)} cannot be read: {error.strerror}; check the path"
        ) from None


def is_record_file(path: Path) -> bool:
    """Return whether a path is the file or the description of a record."""
    return path.is_file() and (path.suffix != ".toml" or is_record_description(path))


def run_plan(plan: Plan, out: Path | None, progress: bool) -> Trajectory:
    """Run a scene in the folder ``run`` of a directory, or continue an existing run there."""
    from granular.run.simulation import simulate

    resume = out is not None
    return simulate(plan, out=None if out is None else out / "run", resume=resume, progress=progress)


def incomplete_run_notes(run: Trajectory) -> tuple[str, ...]:
    """Return notes for the record of an incomplete run."""
    if run.complete:
        return ()
    last = run.stages[-1] if run.stages else None
    stage_text = "before its first stage" if last is None else f"in stage {quote(last.name)}"
    when = float(run.dataset["time"].values[-1])
    return (
        f"the run was stopped at t = {when:.4g} s, {stage_text}, so the record is incomplete; finish it with "
        "run --resume, or regard the results as preliminary",
    )


def time_step_text(run: Trajectory) -> str:
    """Return the time step of a run as text; an automatic step is also given in seconds."""
    settings = run.settings()
    dt = settings["dt"]
    if not isinstance(dt, str):
        return f"{dt:g} s"
    if "shortest_step" in settings and "longest_step" in settings:
        return f"{dt}: {settings['shortest_step']:.3g} to {settings['longest_step']:.3g} s"
    times = run.dataset["time"].values
    mean = float(times[-1] - times[0]) / max(1, settings["steps"])
    return f"{dt}: {mean:.3g} s on average"


RECORD, FALL = "record", "fall"
"""Names of the motions that `piston_record_columns` returns."""


def piston_record_columns(run: Trajectory) -> Mapping[str, Any]:
    """Return times [s] and heights [m] of a run's piston, also of its initial fall if there is one."""
    from granular.protocol.stages import Free

    motions = {RECORD: run.piston()}
    first = run.scene.protocol[0]
    if isinstance(first, Free) and first.name != run.scene.output.record:
        with contextlib.suppress(RecordError):
            motions[FALL] = run.piston(first.name)
    return {
        name: {column: values.tolist() for column, values in motion.columns.items()}
        for name, motion in motions.items()
    }
