"""The commands ``observe`` and ``defects``: what a run shows, as tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import command, given_options, option, print_result
from granular.commands.options import IMPORT, OUTPUT, RUN, quantity_reader
from granular.shared.files import check_output_file, make_directory, write_text

if TYPE_CHECKING:
    import pandas
    import xarray


@command(
    "observe",
    "observables of every frame of a run, as a table",
    RUN,
    option("names", metavar="NAME", nargs="+", help="of an observable; see below, or your own"),
    IMPORT,
    option("-o", "--out", metavar="FILE", help="write the table to this CSV file"),
    option("--force", action="store_true", help="replace the file if it is there"),
    OUTPUT,
    examples="""\
examples:
  %(prog)s runs/bed mean_distance hexatic_order -o order.csv
  %(prog)s runs/bed greatest_force --import mine.py

observables:
  mean_distance     mean distance of two grains
  piston_distance   distance of the piston from the grain next to it
  packing           packing fraction below the piston, or of a periodic cell
  hexatic_order     mean of |psi_6| over the grains
  temperature       kinetic temperature of the bed
  polygons, regularity, defects, interior_cells
                    by the Voronoi cells: a column for each kind
  species_piston_distance, species_temperature
                    a column for each species

mine.py:
  import numpy as np
  from granular.observables import observable

  @observable("N", "greatest force on a grain")
  def greatest_force(frame):
      return np.nanmax(np.linalg.norm(frame.forces, axis=1))""",
)
def observe(options: Any) -> None:
    """Print observables of every frame of a run as a table, or write it to a CSV file."""
    from granular.observables.catalogue import find_observable, observables_table
    from granular.run.trajectory import load_trajectory
    from granular.user_code import import_user_code

    if options.out is not None:
        check_output_file(Path(options.out), options.force)  # before anything is computed
    own = import_user_code(options.user_files).observables
    run = load_trajectory(options.run)
    table = observables_table(run, [find_observable(name, own) for name in options.names])
    if options.out is not None:
        write_text(Path(options.out), table.to_csv(index=False))
    text = table.to_string(index=False) if options.out is None else f"written to {options.out}"
    print_result({"table": table.to_dict("list"), "out": options.out}, text, options.json)


@command(
    "defects",
    "follow dislocations, vacancies and other defects of a run from frame to frame",
    RUN,
    option("--start", type=quantity_reader("s"), metavar="T", default=0.0, help="first time"),
    option("--stop", type=quantity_reader("s"), metavar="T", help="last time"),
    option("--reach", type=float, metavar="A", help="largest displacement from frame to frame, in spacings"),
    option("--memory", type=int, metavar="N", help="frames that a defect may be out of sight"),
    option("--least", type=int, metavar="N", help="leave out what was seen in fewer frames"),
    option("-o", "--out", metavar="DIR", help="write tables and a picture there"),
    OUTPUT,
    examples="""\
examples:
  %(prog)s runs/bed --start 0.2s --stop 0.5s
  %(prog)s runs/bed -o defects

what is written to the directory:
  tracks.csv   kind, life, Burgers vector, speed, glide and climb of each defect
  events.csv   births, annihilations, reactions, and what enters and leaves at the rim
  paths.csv    where each defect was in each frame
  paths.png    the paths over the Voronoi cells of the last frame""",
)
def defects(options: Any) -> None:
    """Follow the defects of a run, and print or write their tracks and events."""
    from granular.observables.defect_tracks import track_defects
    from granular.run.trajectory import load_trajectory

    run = load_trajectory(options.run)
    chosen = given_options(options, "stop", "reach", "memory", "least")
    motion = track_defects(run, options.start, **chosen)
    tracks, events = _defect_track_table(motion), _defect_event_table(motion)
    if options.out is not None:
        times = motion["frame_time"].values
        last = run.dataset["frame_time"].values.searchsorted(times[-1])
        positions = run.scene.cell.wrap_positions(run.dataset["position"].values[last])
        _write_defect_tables(Path(options.out), motion, positions)
    result = {
        "tracks": tracks.to_dict("list"),
        "events": events.to_dict("list"),
        "conserved": motion.attrs["conserved"],
        "out": options.out,
    }
    words = tracks.to_string(index=False, na_rep="", float_format="%.4g") if len(tracks) else ""
    text = f"{len(tracks)} defects, {len(events)} events\n{words}"
    print_result(result, text if options.out is None else f"written to {options.out}", options.json)


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


def _write_defect_tables(directory: Path, motion: xarray.Dataset, positions: Any) -> None:
    from granular.observables.plots import plot_defect_paths
    from granular.render.still import save_picture
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
