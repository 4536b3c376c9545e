"""The command ``impulse``: how soon a machine comes down."""

from __future__ import annotations

import math
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
from granular.shared.files import make_directory, write_text

if TYPE_CHECKING:
    from granular.response.transients import Impulse

WHAT = "how soon a machine that carries a damper comes down after an impulse"
EXAMPLES = """\
examples:
  %(prog)s machine --force 500N --share 0.1 --dt 'auto*4' -o out/impulse
  %(prog)s machine --force 500N --share 0.5 --duration 6s --dt 'auto*4'"""


def add_options(one: Parser) -> None:
    """The command's options."""
    add_scene(one)
    one.add_argument(
        "--force", type=in_unit("N"), metavar="X", required=True,
        help="peak of the impulse, half a sine in time",
    )  # fmt: skip
    one.add_argument(
        "--length", type=in_unit("s"), default=0.02, metavar="T", help="of the impulse (20 ms)"
    )
    one.add_argument(
        "--share", type=in_unit("1"), default=0.1, metavar="S",
        help="share of its peak within which the machine is down: 0.1 (default) or '10 %%'",
    )  # fmt: skip
    one.add_argument(
        "--duration", type=in_unit("s"), default=10.0, metavar="T",
        help="how long the machine is looked at (10 s)",
    )  # fmt: skip
    one.add_argument("-o", "--out", metavar="DIR",
        help="directory for impulse.csv and impulse.png, which keeps the run",
    )  # fmt: skip
    one.add_argument("--dt", default="auto", help="time step [s], 'auto' (default), 'auto*2', ...")
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Strike the machine and say how soon it is down."""
    from granular.own import import_own
    from granular.response.transients import run_impulse

    import_own(options.own_files)
    found = run_impulse(
        scene_of(options), options.force, share=options.share, length=options.length,
        duration=options.duration, dt=time_step(options.dt), out=options.out,
        progress=not options.quiet,
    )  # fmt: skip
    figures: dict[str, Any] = {
        "seconds": found.seconds, "alone": found.alone if math.isfinite(found.alone) else None,
        "share": found.share, "peak": found.peak, "out": options.out,
    }  # fmt: skip
    lines = [str(found)]
    if options.out is not None:
        lines.append(_written(found, Path(options.out)))
    emit(figures, "\n".join(lines), options.json)


def _written(found: Impulse, path: Path) -> str:
    from granular.shared.plotting import figure

    make_directory(path)
    write_text(path / "impulse.csv", found.table.to_csv(index=False))
    with figure() as (drawing, axes):
        found.plot(axes)
        drawing.savefig(path / "impulse.png", dpi=150)
    return f"written to {path}: impulse.csv, impulse.png"
