"""The command ``defects``: defects of a run followed from frame to frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, add_output, emit, in_unit
from granular.shared.files import make_directory, write_text

if TYPE_CHECKING:
    import pandas
    import xarray

WHAT = "follow dislocations, vacancies and other defects of a run from frame to frame"
EXAMPLES = """\
examples:
  %(prog)s runs/bed --start 0.2s --stop 0.5s
  %(prog)s runs/bed -o defects

what is written to the directory:
  tracks.csv   kind, life, Burgers vector, speed, glide and climb of each defect
  events.csv   births, annihilations, reactions, and what enters and leaves at the rim
  paths.csv    where each defect was in each frame
  paths.png    the paths over the Voronoi cells of the last frame"""


def add_options(one: Parser) -> None:
    """The command's options."""
    one.add_argument("run", metavar="RUN", help="directory that a run was written to")
    one.add_argument("--start", type=in_unit("s"), metavar="T", default=0.0, help="first time")
    one.add_argument("--stop", type=in_unit("s"), metavar="T", help="last time")
    one.add_argument(
        "--reach", type=float, metavar="A", help="farthest way from frame to frame, in spacings"
    )
    one.add_argument(
        "--memory", type=int, metavar="N", help="frames that a defect may be out of sight"
    )
    one.add_argument(
        "--least", type=int, metavar="N", help="leave out what was seen in fewer frames"
    )
    one.add_argument("-o", "--out", metavar="DIR", help="write tables and a picture there")
    add_output(one)


def carry_out(options: Any) -> None:
    """Follow the defects."""
    from granular.observables.defect_motion import tracked_defects
    from granular.run.trajectory import load_trajectory

    run = load_trajectory(options.run)
    given = {name: getattr(options, name) for name in ("stop", "reach", "memory", "least")}
    chosen = {name: value for name, value in given.items() if value is not None}
    found = tracked_defects(run, options.start, **chosen)
    tracks, events = _tracks(found), _events(found)
    if options.out is not None:
        times = found["frame_time"].values
        last = run.dataset["frame_time"].values.searchsorted(times[-1])
        positions = run.scene.cell.inside(run.dataset["position"].values[last])
        _write(Path(options.out), found, positions)
    result = {"tracks": tracks.to_dict("list"), "events": events.to_dict("list"),
              "conserved": found.attrs["conserved"], "out": options.out}  # fmt: skip
    words = tracks.to_string(index=False, na_rep="", float_format="%.4g") if len(tracks) else ""
    text = f"{len(tracks)} defects, {len(events)} events\n{words}"
    emit(result, text if options.out is None else f"written to {options.out}", options.json)


def _tracks(found: xarray.Dataset) -> pandas.DataFrame:
    import pandas

    columns = {"kind": found["kind"].values}
    columns |= {f"{name} [s]": found[name].values for name in ("begin", "end")}
    columns |= {name: found[name].values for name in ("born", "ended")}
    for k, axis in enumerate("xy"):
        columns[f"burgers {axis} [m]"] = found["burgers"].values[:, k]
    columns |= {f"{name} [m/s]": found[name].values for name in ("speed", "glide", "climb")}
    return pandas.DataFrame(columns)


def _events(found: xarray.Dataset) -> pandas.DataFrame:
    import pandas

    columns = {"kind": found["event_kind"].values, "time [s]": found["event_time"].values}
    for name in ("position", "burgers"):
        for k, axis in enumerate("xy"):
            columns[f"{name} {axis} [m]"] = found[f"event_{name}"].values[:, k]
    return pandas.DataFrame(columns)


def _paths(found: xarray.Dataset) -> pandas.DataFrame:
    table = found["position"].to_dataframe()["position"].unstack("axis").dropna()
    times = found["frame_time"].to_series()
    table.insert(0, "time [s]", times.loc[table.index.get_level_values("frame")].to_numpy())
    return table.rename(columns={"x": "x [m]", "y": "y [m]"}).reset_index()


def _write(directory: Path, found: xarray.Dataset, positions: Any) -> None:
    from granular.observables.plots import plot_defect_paths
    from granular.render.still import save
    from granular.shared.plotting import figure

    make_directory(directory)
    for name, table in (("tracks", _tracks), ("events", _events), ("paths", _paths)):
        write_text(directory / f"{name}.csv", table(found).to_csv(index=False))
    with figure(width=7.2, height=5.4) as (drawing, axes):
        plot_defect_paths(found, positions, axes)
        save(drawing, directory / "paths.png", overwrite=True)
