"""Command line of the simulation: ``python -m granular``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from granular.console import (
    Parser,
    add_output,
    add_run,
    add_scene,
    changes_from,
    emit,
    launch,
    time_step,
)

if TYPE_CHECKING:
    from granular.scene import Scene
    from granular.trajectory import Trajectory


def parser() -> Parser:
    """The command line's grammar."""
    top = Parser(
        prog="python -m granular",
        description="Simulate beds of repelling magnets and the piston on them.",
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    one = commands.add_parser("scenes", help="list the packaged scenes")
    add_output(one)
    one = commands.add_parser("show", help="what a scene holds, in SI and in natural units")
    add_scene(one)
    add_output(one)
    one = commands.add_parser("run", help="run a scene")
    add_scene(one)
    one.add_argument("-o", "--out", metavar="DIR", help="directory to write the run to")
    one.add_argument("--t-end", type=float, metavar="S", help="stop at this time [s]")
    one.add_argument("--resume", action="store_true", help="go on with the run in DIR")
    add_run(one)
    add_output(one)
    return top


def main(arguments: Sequence[str]) -> None:
    """Run one command."""
    options = parser().parse_args(arguments)
    {"scenes": _scenes, "show": _show, "run": _run}[options.command](options)


def _scene(options: Any) -> Scene:
    from granular.scene import load_scene

    return load_scene(options.scene).replace(**changes_from(options.changes))


def _scenes(options: Any) -> None:
    from granular.scene import SCENES, scene_names

    first = {}
    for name in scene_names():
        lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
        comment = [line[1:].strip() for line in lines if line.startswith("#")]
        first[name] = " ".join(comment)
    width = max(map(len, first))
    emit(first, "\n".join(f"{name:{width}}  {text}" for name, text in first.items()), options.json)


def _show(options: Any) -> None:
    from granular.summary import scene_figures, scene_text

    scene = _scene(options)
    emit({"scene": scene.plain(), "figures": scene_figures(scene)}, scene_text(scene), options.json)


def _run(options: Any) -> None:
    from granular.simulation import simulate

    run = simulate(
        _scene(options),
        dt=time_step(options.dt),
        t_end=options.t_end,
        method=options.method,
        out=options.out,
        resume=options.resume,
        threads=options.threads,
        progress=not options.quiet,
    )
    emit(*_outcome(run), options.json)


def _outcome(run: Trajectory) -> tuple[dict[str, Any], str]:
    from granular.summary import run_figures, run_text

    return run_figures(run), run_text(run)


if __name__ == "__main__":
    sys.exit(launch(main))
