"""Command line of the identification: ``python -m reduced_models``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

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


def parser() -> Parser:
    """The command line's grammar."""
    top = Parser(prog="python -m reduced_models", description="From a motion to its equation.")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "identify",
        help="simulate (or read) a piston's motion, fit laws to it, and write a report",
    )
    add_scene(
        command,
        "source",
        "a scene (name or TOML file), a run directory, or a CSV file with time, height",
    )
    command.add_argument("-o", "--out", metavar="DIR", help="directory for report, models and run")
    command.add_argument(
        "--law", dest="laws", action="append", metavar="NAME", help="law to fit (repeatable)"
    )
    command.add_argument("--starts", type=int, default=16, help="random starts of each fit")
    command.add_argument(
        "--no-checks", action="store_true", help="skip the runs that show step error and scatter"
    )
    add_run(command)
    add_output(command)
    return top


def main(arguments: Sequence[str]) -> None:
    """Run one command."""
    options = parser().parse_args(arguments)
    {"identify": _identify}[options.command](options)


def _identify(options: Any) -> None:
    from reduced_models.identification import LAWS, identify

    found = identify(
        options.source,
        options.out,
        laws=options.laws or LAWS,
        changes=changes_from(options.changes),
        dt=time_step(options.dt),
        method=options.method,
        threads=options.threads,
        starts=options.starts,
        checks=not options.no_checks,
        progress=not options.quiet,
    )
    text = str(found)
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    emit(found.to_plain(), text, options.json)


if __name__ == "__main__":
    sys.exit(launch(main))
