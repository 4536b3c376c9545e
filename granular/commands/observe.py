"""The commands ``observe`` and ``defects``: observables and defects of a run, as tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from granular.commands.console import command, given_options, print_result
from granular.commands.options import OutputOptions, RunDirectory, UserCodeOptions
from granular.commands.signature import Option, Seconds
from granular.shared.blocks import Block, Table, Text, format_number
from granular.shared.files import check_output_file, make_directory, write_text

if TYPE_CHECKING:
    import pandas
    import xarray


@command("""\
examples:
  %(prog)s runs/bed mean_distance hexatic_order -o order.csv
  %(prog)s runs/bed maximum_force --import mine.py

observables:
  mean_distance     mean distance of two grains
  piston_distance   distance of the piston from the grain next to it
  packing           packing fraction below the piston, or of a periodic cell
  hexatic_order     mean of |psi_6| over the grains
  temperature       kinetic temperature of the bed
  polygons, regularity, defects, interior_cells
                    of the Voronoi cells; one column for each kind
  species_piston_distance, species_temperature
                    a column for each species

mine.py:
  import numpy as np
  from granular.observables import observable

  @observable("N", "maximum force on a grain")
  def maximum_force(frame):
      return np.nanmax(np.linalg.norm(frame.forces, axis=1))""")
def observe(
    run: RunDirectory,
    names: Annotated[tuple[str, ...], Option("name of an observable; see below, or a custom one", "NAME")],
    *,
    own: UserCodeOptions,
    out: Annotated[str | None, Option("write the table to this CSV file", "FILE", "-o")] = None,
    force: Annotated[bool, Option("replace an existing file")] = False,
    output: OutputOptions,
) -> None:
    """Compute observables of each frame of a run, as a table."""
    from granular.observables.catalogue import OBSERVABLES, observables_table
    from granular.run.trajectory import load_trajectory

    if out is not None:
        check_output_file(Path(out), force)  # before anything is computed
    own.import_user_code()
    table = observables_table(load_trajectory(run), [OBSERVABLES.find(name) for name in names])
    if out is not None:
        write_text(Path(out), table.to_csv(index=False))
    shown = _table_of_data_frame(table) if out is None else Text(f"written to {out}")
    print_result({"table": table.to_dict("list"), "out": out}, [shown], output.json)


@command("""\
examples:
  %(prog)s runs/bed --start 0.2s --stop 0.5s
  %(prog)s runs/bed -o defects

files in the directory:
  tracks.csv   kind, life, Burgers vector, speed, glide and climb of each defect
  events.csv   births, annihilations, reactions, and defects that enter and leave at the rim
  paths.csv    position of each defect in each frame
  paths.png    the paths over the Voronoi cells of the last frame""")
def defects(
    run: RunDirectory,
    *,
    start: Annotated[Seconds, Option("first time", "T")] = 0.0,
    stop: Annotated[Seconds | None, Option("last time", "T")] = None,
    reach: Annotated[
        float | None, Option("maximum displacement of a defect from frame to frame, in lattice spacings", "A")
    ] = None,
    memory: Annotated[
        int | None, Option("maximum number of frames in which a defect may go undetected", "N")
    ] = None,
    least: Annotated[
        int | None, Option("minimum number of frames in which a defect is detected", "N")
    ] = None,
    out: Annotated[str | None, Option("directory for tables and a picture", "DIR", "-o")] = None,
    output: OutputOptions,
) -> None:
    """Follow dislocations, vacancies and other defects of a run from frame to frame."""
    from granular.observables.defect_tracks import track_defects
    from granular.run.trajectory import load_trajectory

    trajectory = load_trajectory(run)
    chosen = given_options(stop=stop, reach=reach, memory=memory, minimum_frames=least)
    motion = track_defects(trajectory, start, **chosen)
    tracks, events = _defect_track_table(motion), _defect_event_table(motion)
    if out is not None:
        times = motion["frame_time"].values
        last = trajectory.dataset["frame_time"].values.searchsorted(times[-1])
        positions = trajectory.scene.cell.wrap_positions(trajectory.dataset["position"].values[last])
        _write_defect_tables_and_picture(Path(out), motion, positions)
    result = {
        "tracks": tracks.to_dict("list"),
        "events": events.to_dict("list"),
        "conserved": motion.attrs["conserved"],
        "out": out,
    }
    blocks: list[Block] = [Text(f"{len(tracks)} defects, {len(events)} events"), _table_of_data_frame(tracks)]
    print_result(result, blocks if out is None else f"written to {out}", output.json)


def _table_of_data_frame(frame: pandas.DataFrame) -> Table:
    rows = [[_cell_text(value) for value in row] for row in frame.itertuples(index=False)]
    return Table(list(map(str, frame.columns)), rows)


def _cell_text(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else format_number(value, 6)
    return str(value)


def _defect_track_table(motion: xarray.Dataset) -> pandas.DataFrame:
    import pandas

    columns = {"kind": motion["kind"].values}
    columns |= {f"{name} [s]": motion[name].values for name in ("begin", "end")}
    columns |= {name: motion[name].values for name in ("born", "ended")}
    for k, axis in enumerate("xy"):
        columns[f"burgers {axis} [m]"] = motion["burgers"].values[:, k]
    columns |= {f"{name} [m/s]": motion[name].values for name in ("speed", "glide", "climb")}
    return pandas.DataFrame(columns)


def _defect_event_table(motion: xarray.Dataset) -> pandas.DataFrame:
    import pandas

    columns = {"kind": motion["event_kind"].values, "time [s]": motion["event_time"].values}
    for name in ("position", "burgers"):
        for k, axis in enumerate("xy"):
            columns[f"{name} {axis} [m]"] = motion[f"event_{name}"].values[:, k]
    return pandas.DataFrame(columns)


def _defect_path_table(motion: xarray.Dataset) -> pandas.DataFrame:
    table = motion["position"].to_dataframe()["position"].unstack("axis").dropna()
    times = motion["frame_time"].to_series()
    table.insert(0, "time [s]", times.loc[table.index.get_level_values("frame")].to_numpy())
    return table.rename(columns={"x": "x [m]", "y": "y [m]"}).reset_index()


def _write_defect_tables_and_picture(directory: Path, motion: xarray.Dataset, positions: Any) -> None:
    from granular.observables.plots import plot_defect_paths
    from granular.render.picture import save_picture
    from granular.shared.plotting import figure

    make_directory(directory)
    for name, table in (
        ("tracks", _defect_track_table),
        ("events", _defect_event_table),
        ("paths", _defect_path_table),
    ):
        write_text(directory / f"{name}.csv", table(motion).to_csv(index=False))
    with figure(width=7.2, height=5.4) as (drawing, axes):
        plot_defect_paths(motion, positions, axes)
        save_picture(drawing, directory / "paths.png", overwrite=True)
