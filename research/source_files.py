"""Conversion of a run to the ``.dat`` files of de Paula's program [D, Appendix B].

``python -m research.source_files RUN -o DIR`` writes the files.

The thesis gives the names of the files and the intervals at which they are written. All else is chosen here:

- All numbers are dimensionless, as in de Paula's computations: lengths in D, times in T, masses
  in m, forces in m D/T^2. ``charUnits.dat`` holds these units in SI: D, T, m, D/T, m D/T^2.
- T is the duration of the compression, stroke/V_c; a run without compression has T = 1 s, as the
  source's single particle.
- De Paula's step is 1e-6 T, so "every 250 time steps" is every 2.5e-4 T. Nothing is interpolated: for each
such time the nearest recorded frame is written, once. If a run was recorded more coarsely, all of its frames
are in the files.
- Particle files have one line per grain, in the order of the scene; a comment with number and time
  comes before each frame and a blank line after it. Grains that have left the cell have no line;
  the comment names them.
- ``posPart``, ``velPart``, ``forPart`` have the columns x and y; the force is magnetic and weight
  (and contact), without friction and drag. ``comPart`` has one column: the compressive force, the
  sum of the magnitudes of the forces of all other grains and of the walls, whose distribution is bimodal in
  the thesis [D, Figs. 4.22 and 5.3]. It is omitted, with ``comPart_norm``, if a custom effect acts between
  grains, since only the sum of its forces is known.
- ``piston`` has the columns time and height, ``avgDis`` time and mean distance, in de Paula's
  convention: half of the mean over all pairs.
- The files with ``_0`` (every 10 steps) cover the whole run, and are omitted if they would only repeat the
files without.
- ``comPart_norm`` is divided by its maximum in the run; ``posPart_norm`` is in D.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from granular.commands.console import Parser, print_result, run_command_and_return_exit_code
from granular.commands.options import OutputOptions, RunDirectory
from granular.commands.signature import Option, add_options, collect_arguments_from_options
from granular.export.frames import iterate_frames, load_run_if_path
from granular.observables import depaula_pair_distance
from granular.observables.catalogue import grain_compressive_force
from granular.observables.forces import effects_of_unknown_pair_force
from granular.observables.frame import Frame, present_grain_mask
from granular.protocol import Move
from granular.run.trajectory import Trajectory
from granular.schema.natural_units import Scales
from granular.shared.files import write_line_files

STEPS_PER_TIME = 10**6
"""Time step of de Paula in its unit of time T [D, 2.3.2]."""

USUAL, FINE, COARSE = 250, 10, 1000
"""De Paula's steps between records: of most files, of files with _0, of averages."""


class DepaulaTimeUnits(NamedTuple):
    """De Paula's clock for a run."""

    time_unit: float  # T, the duration of the compression [s]
    step: float  # 1e-6 T [s]
    frame_interval: float  # 250 steps: ``output.frames`` for files as fine as de Paula's [s]


def depaula_time_units_of_run(run: Trajectory) -> DepaulaTimeUnits:
    """Return de Paula's units of time for a run: T, its step, and its interval of frames."""
    unit = 1.0
    height = None if run.scene.piston is None else run.scene.piston.height
    for stage, done in zip(run.scene.protocol, run.stages, strict=False):
        if isinstance(stage, Move) and height is not None and stage.to < height:
            unit = stage.maximum_duration(height) or unit
            break
        height = done.height
    return DepaulaTimeUnits(unit, unit / STEPS_PER_TIME, USUAL * unit / STEPS_PER_TIME)


def to_depaula_files(
    run: Trajectory | str | Path, directory: str | Path, *, overwrite: bool = False, progress: bool = False
) -> tuple[Path, ...]:
    """Write the files of de Paula's program; see the module's docstring for their contents.

    All files appear together when the last one is complete. A warning is given if the run was recorded more
    coarsely than de Paula's files.
    """
    run, directory = load_run_if_path(run), Path(directory)
    depaula_time = depaula_time_units_of_run(run)
    contents = {
        **_particle_files(run, depaula_time, progress),
        **_piston_files(run, depaula_time),
        "avgDis": _mean_distance_lines(run, depaula_time, progress),
        **_constant_files(run, depaula_time),
    }
    files = {f"{name}.dat": lines for name, lines in contents.items()}
    written = write_line_files(directory, files, overwrite)
    _warn_of_coarse_frames(run, depaula_time)
    return written


def _warn_of_coarse_frames(run: Trajectory, depaula_time: DepaulaTimeUnits) -> None:
    times = run.dataset["frame_time"].values
    interval = (times[-1] - times[0]) / max(1, len(times) - 1)
    if interval > 1.01 * depaula_time.frame_interval:
        warnings.warn(
            f"the run has a frame every {interval:.3g} s, de Paula every {depaula_time.frame_interval:.3g} s "
            f"({USUAL} steps of 1e-6 T); all frames are written; lower output.frames for more",
            stacklevel=3,
        )


def _nearest_record_indices(times: np.ndarray, depaula_time: DepaulaTimeUnits, every: int) -> list[int]:
    """Return the distinct indices of the records nearest to multiples of a number of de Paula's steps."""
    interval = every * depaula_time.step
    instants = np.arange(np.floor(times[-1] / interval + 1e-9) + 1.0) * interval
    after = np.clip(np.searchsorted(times, instants), 1, max(1, len(times) - 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    nearer = np.where(instants - times[before] <= times[after] - instants, before, after)
    return [int(grain) for grain in np.unique(nearer)]


def _table_text(table: np.ndarray) -> str:
    """Return the lines of a table (k, columns), with all digits."""
    line = " ".join(["%.17g"] * table.shape[1]) + "\n"
    return line * len(table) % tuple(table.ravel().tolist())


def _particle_files(
    run: Trajectory, depaula_time: DepaulaTimeUnits, progress: bool
) -> dict[str, Iterator[str]]:
    units, unit = Scales.from_grains(run.scene.grains), depaula_time.time_unit
    speed, force = units.length / unit, units.mass * units.length / unit**2
    tables: dict[str, tuple[str, Callable[[Frame], np.ndarray]]] = {
        "posPart": ("x y [D]", lambda frame: frame.positions / units.length),
        "velPart": ("x y [D/T]", lambda frame: frame.velocities / speed),
        "forPart": ("x y [m D/T^2]", lambda frame: frame.forces / force),
    }
    apart = not effects_of_unknown_pair_force(run.scene)
    if apart:
        compression = "compression [m D/T^2]"
        tables["comPart"] = compression, lambda frame: grain_compressive_force(frame)[:, None] / force
    times = run.dataset["frame_time"].values
    chosen = {every: _nearest_record_indices(times, depaula_time, every) for every in (FINE, USUAL, COARSE)}
    files: dict[str, Iterator[str]] = {}

    def add(name: str, every: int, table: tuple[str, Callable[[Frame], np.ndarray]]) -> None:
        bar = f"{name}.dat" if progress else None
        files[name] = _particle_file_lines(run, depaula_time, every, chosen[every], *table, bar)

    for name, table in tables.items():
        add(name, USUAL, table)
        if len(chosen[FINE]) > len(chosen[USUAL]):
            add(f"{name}_0", FINE, table)
    if apart:
        coarse = iterate_frames(run, chosen[COARSE])
        sizes = (float(np.fmax.reduce(grain_compressive_force(frame), initial=0.0)) for frame in coarse)
        greatest = max(sizes, default=0.0) or 1.0
        norm = "compression/(its greatest)", lambda frame: grain_compressive_force(frame)[:, None] / greatest
        add("comPart_norm", COARSE, norm)
    add("posPart_norm", COARSE, tables["posPart"])
    return files


def _particle_file_lines(
    run: Trajectory,
    depaula_time: DepaulaTimeUnits,
    every: int,
    chosen: Sequence[int],
    columns: str,
    table: Callable[[Frame], np.ndarray],
    bar: str | None,
) -> Iterator[str]:
    yield f"# {columns}, every {every} steps\n"
    for number, frame in zip(chosen, iterate_frames(run, chosen, bar), strict=True):
        present = present_grain_mask(frame.positions)
        absent = np.flatnonzero(~present)
        note = f", without grains {' '.join(map(str, absent))}" if len(absent) else ""
        yield f"# frame {number}, t = {frame.time / depaula_time.time_unit:.17g} T{note}\n"
        yield _table_text(table(frame)[present]) + "\n"


def _piston_files(run: Trajectory, depaula_time: DepaulaTimeUnits) -> dict[str, Iterator[str]]:
    if run.scene.piston is None:
        return {}
    diameter = run.scene.grains.species[0].diameter
    times = run.dataset["time"].values
    heights = run.dataset["piston_height"].values

    def lines(chosen: list[int], every: int) -> Iterator[str]:
        yield f"# t [T], height [D], every {every} steps\n"
        yield _table_text(np.column_stack([times / depaula_time.time_unit, heights / diameter])[chosen])

    usual, fine = (_nearest_record_indices(times, depaula_time, every) for every in (USUAL, FINE))
    files = {"piston": lines(usual, USUAL)}
    if len(fine) > len(usual):
        files["piston_0"] = lines(fine, FINE)
    return files


def _mean_distance_lines(run: Trajectory, depaula_time: DepaulaTimeUnits, progress: bool) -> Iterator[str]:
    diameter = run.scene.grains.species[0].diameter
    chosen = _nearest_record_indices(run.dataset["frame_time"].values, depaula_time, COARSE)
    yield f"# t [T], half of the mean distance of the pairs [D], every {COARSE} steps\n"
    for frame in iterate_frames(run, chosen, "avgDis.dat" if progress else None):
        distance = depaula_pair_distance(frame.positions) / diameter
        yield _table_text(np.array([[frame.time / depaula_time.time_unit, distance]]))


def _constant_files(run: Trajectory, depaula_time: DepaulaTimeUnits) -> dict[str, Iterator[str]]:
    units, unit = Scales.from_grains(run.scene.grains), depaula_time.time_unit
    sizes = (units.length, unit, units.mass, units.length / unit, units.mass * units.length / unit**2)
    scales = run.scene.grains.diameters() / units.length
    return {
        "charUnits": iter(
            ["# D [m], T [s], m [kg], D/T [m/s], m D/T^2 [N]\n", _table_text(np.array(sizes)[:, None])]
        ),
        "scales": iter(["# diameter of each grain [D]\n", _table_text(scales[:, None])]),
    }


def write_source_files(
    run: RunDirectory,
    *,
    out: Annotated[str, Option("directory for the files", "DIR", "-o")],
    force: Annotated[bool, Option("replace existing files")] = False,
    output: OutputOptions,
) -> None:
    """Write a run as the ``.dat`` files of de Paula's program."""
    written = to_depaula_files(run, out, overwrite=force, progress=output.shows_progress)
    files = [str(file) for file in written]
    print_result({"files": files}, f"{len(files)} files written to {out}", output.json)


def main(arguments: Sequence[str]) -> None:
    """Write the files of the run given by the arguments."""
    parser = Parser(prog="python -m research.source_files", description=write_source_files.__doc__)
    add_options(parser, write_source_files)
    write_source_files(**collect_arguments_from_options(write_source_files, parser.parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
