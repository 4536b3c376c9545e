"""The command ``response``: what is left of a machine's vibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    Parser,
    add_import,
    add_output,
    add_scene,
    emit,
    in_unit,
    time_step,
)
from granular.commands.given_scene import scene_of
from granular.shared.errors import InputError
from granular.shared.files import make_directory, write_text
from granular.shared.messages import quoted

if TYPE_CHECKING:
    from granular.response.response import Response
    from granular.scene.scene import Scene

WHAT = "frequency response of a machine that carries a damper"
EXAMPLES = """\
examples:
  %(prog)s machine --from 2.6Hz --to 3.6Hz --points 9 --dt 'auto*4' -o out/machine
  %(prog)s machine --from 2.8Hz --to 3Hz --points 3 --dt 'auto*4' --force 5N --force 10N -o two
  %(prog)s machine --from 2.5Hz --to 3.5Hz --sweep 40s --dt 'auto*4' -o out/sweep

Each sine is a run; --sweep makes one run of all. report.html in DIR shows what was found."""
POINTS, SINE = 25, 20.0
"""Frequencies of sines, and how long each acts [s], if not given."""


def add_options(one: Parser) -> None:
    """The command's options."""
    add_scene(one)
    one.add_argument(
        "--from",
        dest="lowest",
        type=in_unit("Hz"),
        metavar="F",
        required=True,
        help="lowest frequency of the sine",
    )
    one.add_argument(
        "--to",
        dest="highest",
        type=in_unit("Hz"),
        metavar="F",
        required=True,
        help="highest frequency of the sine",
    )
    one.add_argument(
        "--points", type=int, metavar="N", help="frequencies (25; 200 read off a sweep)"
    )
    for name, unit in (("force", "N"), ("acceleration", "m/s^2"), ("displacement", "m")):
        one.add_argument(
            f"--{name}", type=in_unit(unit), action="append", metavar="X",
            help=f"amplitude of the {name} (repeatable)",
        )  # fmt: skip
    one.add_argument(
        "--duration", type=in_unit("s"), metavar="T", help="how long each sine acts (20 s)"
    )
    one.add_argument(
        "--sweep", type=in_unit("s"), metavar="T",
        help="in place of sines, one run under a sweep from the lowest to the highest frequency "
        "that takes this long, of the first amplitude",
    )  # fmt: skip
    one.add_argument("-o", "--out", metavar="DIR",
        help="directory for report.html, response.csv and response.png, which keeps what is done",
    )  # fmt: skip
    one.add_argument("--dt", default="auto", help="time step [s], 'auto' (default), 'auto*2', ...")
    one.add_argument("--workers", type=int, metavar="N", help="processes on this machine")
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Run the sines, or the sweep, and say what is left."""
    from granular.own import import_own

    import_own(options.own_files)
    points = POINTS if options.points is None else options.points
    if not 0.0 < options.lowest < options.highest or points < 2:
        raise InputError(
            f"--from {options.lowest:g} --to {options.highest:g} --points {points}: give "
            "two frequencies, the lower one first, and at least 2 points"
        )
    scene, sizes = _shaken(options)
    found = _stepped(options, scene, sizes) if options.sweep is None else _swept(options, scene)
    lines, figures = [found.table], {"peaks": found.peaks(), "out": options.out}
    if options.sweep is not None:
        from granular.response.transients import pace_of_sweep

        figures["pace"] = pace_of_sweep(found)
        if figures["pace"] is not None:
            lines.append(
                f"pace of the sweep at the peak: {figures['pace']:.2g} of what the machine with "
                "its damper can follow; far below 1 is slow enough"
            )
    if options.out is not None:
        lines.append(_written(found, Path(options.out)))
    emit(figures, "\n".join(lines), options.json)


def _shaken(options: Any) -> tuple[Scene, list[float] | None]:
    """The scene under the first amplitude that was given, and all of them."""
    from granular.response.response import AMPLITUDES

    scene = scene_of(options)
    given = {name: getattr(options, name) for name in AMPLITUDES if getattr(options, name)}
    if len(given) > 1:
        raise InputError(f"--{' and --'.join(given)} together; give one of them")
    host = scene.effects.host
    if host is None:
        raise InputError(
            f"the scene {quoted(scene.name)} has no host; give it effects.host, or take the "
            "packaged scene 'machine'"
        )
    if not given and host.excitation is None:
        raise InputError(
            f"nothing shakes the host of {quoted(scene.name)}; give --force, --acceleration or "
            "--displacement"
        )
    for name, sizes in given.items():
        kept = {"kind": "sine", "frequency": 1.0, name: sizes[0]}
        if host.excitation is not None:
            kept["start"] = host.excitation.start
        scene = scene.replace(**{"effects.host.excitation": kept})
    return scene, next(iter(given.values()), None)


def _stepped(options: Any, scene: Scene, sizes: list[float] | None) -> Response:
    import numpy as np

    from granular.response.response import frequency_response

    points = POINTS if options.points is None else options.points
    return frequency_response(
        scene,
        np.geomspace(options.lowest, options.highest, points).tolist(),
        amplitudes=sizes,
        duration=SINE if options.duration is None else options.duration,
        dt=time_step(options.dt), out=options.out,
        workers=options.workers, progress=not options.quiet,
    )  # fmt: skip


def _swept(options: Any, scene: Scene) -> Response:
    from granular.response.swept import POINTS as READ
    from granular.response.transients import run_sweep

    for name in ("duration", "workers"):
        if getattr(options, name) is not None:
            raise InputError(
                f"--{name} is for sines; a sweep is one run as long as --sweep says: leave it out"
            )
    return run_sweep(
        scene, options.lowest, options.highest, options.sweep,
        points=READ if options.points is None else options.points,
        dt=time_step(options.dt), out=options.out, progress=not options.quiet,
    )  # fmt: skip


def _written(found: Response, path: Path) -> str:
    from granular.response.kept import save_response
    from granular.response.page import response_page
    from granular.shared.plotting import figure

    make_directory(path)
    save_response(found, path)
    table = found.dataset.to_dataframe().reset_index()
    write_text(path / "response.csv", table.to_csv(index=False))
    with figure() as (drawing, axes):
        found.plot(axes)
        drawing.savefig(path / "response.png", dpi=150)
    response_page(found).save(path / "report.html")
    return f"written to {path}: report.html, response.csv, response.png"
