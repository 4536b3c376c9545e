"""Command line of the simulation: ``python -m granular``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from granular.commands import (
    defects,
    export,
    impulse,
    methods,
    observe,
    render,
    response,
    run,
    scenes,
    schema,
    show,
    sweep,
    warm_up,
)
from granular.commands.console import Parser, command_parser, launch

PROG = "python -m granular"

_FIRST_RUN = """\
a first run, looked at:
  %(prog)s scenes
  %(prog)s show bed
  %(prog)s run bed --t-end 0.5 -o runs/bed
  %(prog)s render runs/bed -o speed.png --colour speed"""

COMMANDS = {
    "scenes": scenes,
    "methods": methods,
    "show": show,
    "schema": schema,
    "run": run,
    "observe": observe,
    "defects": defects,
    "export": export,
    "render": render,
    "sweep": sweep,
    "response": response,
    "impulse": impulse,
    "warm-up": warm_up,
}


def parser(prog: str = PROG) -> Parser:
    """The command line's grammar; ``prog`` is what the user types before a command."""
    examples = {"": _FIRST_RUN} | {name: one.EXAMPLES for name, one in COMMANDS.items()}
    top, add = command_parser(
        prog, "Simulate beds of repelling magnets and the piston on them.", examples
    )
    for name, one in COMMANDS.items():
        one.add_options(add(name, one.WHAT))
    return top


def main(arguments: Sequence[str], prog: str = PROG) -> None:
    """Run one command."""
    options = parser(prog).parse_args(arguments)
    COMMANDS[options.command].carry_out(options)


if __name__ == "__main__":
    sys.exit(launch(main))
