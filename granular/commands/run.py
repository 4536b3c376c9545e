"""The command ``run``: run a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    Parser,
    add_accuracy,
    add_output,
    add_run,
    add_scene,
    emit,
    in_unit,
    time_step,
)
from granular.commands.given_scene import scene_of

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

WHAT = "run a scene"
EXAMPLES = """\
examples:
  %(prog)s bed --t-end 0.5 -o runs/bed
  %(prog)s damper --set piston.mass=6.5 --set 'effects.drag.coefficient=0.2 kg/s'
  %(prog)s damper --accuracy '1e-2 rest height'
  %(prog)s damper -o runs/damper --resume     # goes on after Ctrl-C"""


def add_options(one: Parser) -> None:
    """The command's options."""
    add_scene(one)
    one.add_argument("-o", "--out", metavar="DIR", help="directory to write the run to")
    one.add_argument(
        "--t-end", type=in_unit("s"), metavar="T", help="stop at this time, as 0.5 or '500 ms'"
    )
    one.add_argument("--resume", action="store_true", help="go on with the run in DIR")
    add_run(one)
    add_accuracy(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Run a scene."""
    from granular.own import import_own
    from granular.run.simulation import simulate

    import_own(options.own_files)
    run = simulate(
        scene_of(options),
        dt=time_step(options.dt),
        t_end=options.t_end,
        method=options.method,
        out=options.out,
        resume=options.resume,
        threads=options.threads,
        progress=not options.quiet,
        accuracy=options.accuracy,
    )
    emit(*_outcome(run), options.json)


def _outcome(run: Trajectory) -> tuple[dict[str, Any], str]:
    from granular.run.price import price_text
    from granular.run.summary import run_figures, run_text

    figures = run_figures(run) | {"price": price_text(run)}
    lines = [run_text(run)]
    if run.path is None:
        lines.append("nothing is kept of the run; -o DIR keeps it")
    if "accuracy" in figures:
        lines.append(f"chosen for {figures['accuracy']}")
    return figures, "\n".join([*lines, figures["price"]])
