"""The command ``response``: what is left of a machine's vibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granular.commands.given_scene import scene_of
from granular.shared.console import (
    Parser,
    add_import,
    add_output,
    add_scene,
    emit,
    in_unit,
    time_step,
)
from granular.shared.errors import InputError
from granular.shared.files import make_directory, write_text

WHAT = "frequency response of a machine that carries a damper"
EXAMPLES = """\
examples:
  %(prog)s machine --from 2.6Hz --to 3.6Hz --points 9 --dt 'auto*4' -o out/machine
  %(prog)s machine --from 2.8Hz --to 3Hz --points 3 --dt 'auto*4' --force 5N --force 10N -o two"""


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
    one.add_argument("--points", type=int, default=25, metavar="N", help="frequencies (25)")
    for name, unit in (("force", "N"), ("acceleration", "m/s^2"), ("displacement", "m")):
        one.add_argument(
            f"--{name}", type=in_unit(unit), action="append", metavar="X",
            help=f"amplitude of the {name} (repeatable)",
        )  # fmt: skip
    one.add_argument(
        "--duration", type=in_unit("s"), default=20.0, metavar="T",
        help="how long each sine acts (20 s)",
    )  # fmt: skip
    one.add_argument("-o", "--out", metavar="DIR", help="directory that keeps what is done")
    one.add_argument("--dt", default="auto", help="time step [s], 'auto' (default), 'auto*2', ...")
    one.add_argument("--workers", type=int, metavar="N", help="processes on this machine")
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Run the sines and say what is left."""
    import numpy as np

    from granular.own import import_own
    from granular.response.response import AMPLITUDES, frequency_response

    import_own(options.own_files)
    if not 0.0 < options.lowest < options.highest or options.points < 2:
        raise InputError(
            f"--from {options.lowest:g} --to {options.highest:g} --points {options.points}: give "
            "two frequencies, the lower one first, and at least 2 points"
        )
    scene = scene_of(options)
    given = {name: getattr(options, name) for name in AMPLITUDES if getattr(options, name)}
    if len(given) > 1:
        raise InputError(f"--{' and --'.join(given)} together; give one of them")
    for name, sizes in given.items():
        kept = {"kind": "sine", "frequency": 1.0, name: sizes[0]}
        if scene.effects.host is not None and scene.effects.host.excitation is not None:
            kept["start"] = scene.effects.host.excitation.start
        scene = scene.replace(**{"effects.host.excitation": kept})
    found = frequency_response(
        scene,
        np.geomspace(options.lowest, options.highest, options.points).tolist(),
        amplitudes=next(iter(given.values()), None),
        duration=options.duration, dt=time_step(options.dt), out=options.out,
        workers=options.workers, progress=not options.quiet,
    )  # fmt: skip
    lines, figures = [found.table], {"peaks": found.peaks(), "out": options.out}
    if options.out is not None:
        lines.append(_written(found, Path(options.out)))
    emit(figures, "\n".join(lines), options.json)


def _written(found: Any, path: Path) -> str:
    from granular.shared.plotting import axes_or_new

    make_directory(path)
    table = found.dataset.to_dataframe().reset_index()
    write_text(path / "response.csv", table.to_csv(index=False))
    ax = found.plot(axes_or_new(None))
    ax.figure.savefig(path / "response.png", dpi=150, bbox_inches="tight")
    return f"written to {path}: response.csv, response.png"
