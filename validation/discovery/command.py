"""Command line: ``python -m validation discovery``."""

from __future__ import annotations

import argparse
from typing import Any

from granular.shared.console import add_output, emit
from granular.shared.errors import InputError
from granular.shared.messages import quoted

DIRECTORY = "out/discovery"


def add_discovery(one: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    one.add_argument(
        "-o", "--out", metavar="DIR", default=DIRECTORY,
        help=f"directory for cases and results; what was run is found again ({DIRECTORY} if not "
        "given)",
    )  # fmt: skip
    length = one.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="three systems, within minutes")
    length.add_argument(
        "--full", action="store_true",
        help="all that the options name, in hours; without any of these nothing is run",
    )  # fmt: skip
    length.add_argument(
        "--guide", action="store_true",
        help="write table and picture of the results that come with the package into the guide",
    )  # fmt: skip
    one.add_argument(
        "--systems", metavar="NAME,...", help="of the fourteen, such as 'pendulum,two wells'"
    )
    one.add_argument("--noise", metavar="SHARE,...", help="of 0.001, 0.01, 0.03 and 0.1")
    one.add_argument("--seeds", type=int, metavar="N", help="1 to 5 (5 if not given)")
    one.add_argument("--anew", action="store_true", help="run also what the directory keeps")
    add_output(one)


def run_discovery(options: Any) -> None:
    """Run the command."""
    from validation.discovery.programme import RESULTS, discovery
    from validation.discovery.results import committed
    from validation.discovery.text import summary, text

    if options.guide:
        from validation.discovery.guide import write_guide

        pages = [str(path) for path in write_guide(committed())]
        emit({"pages": pages}, "written: " + ", ".join(pages), options.json)
        return
    if not (options.quick or options.full):
        found = committed()
        emit(summary(found), text(found), options.json)
        return
    found = discovery(
        options.out,
        quick=options.quick,
        systems=()
        if options.systems is None
        else tuple(word.strip() for word in options.systems.split(",")),
        noises=_noises(options.noise),
        seeds=_seeds(options.seeds),
        anew=options.anew,
        progress=not options.quiet,
    )
    emit(summary(found), f"{text(found)}\nresults: {options.out}/{RESULTS}", options.json)


def _noises(text: str | None) -> tuple[float, ...]:
    from validation.discovery.cases import NOISES

    if text is None:
        return NOISES
    known = {f"{noise:g}": noise for noise in NOISES}
    try:
        return tuple(known[f"{float(word):g}"] for word in text.split(","))
    except (ValueError, KeyError):
        raise InputError(f"--noise {quoted(text)}; give some of {', '.join(known)}") from None


def _seeds(count: int | None) -> int:
    from validation.discovery.cases import SEEDS

    if count is None:
        return SEEDS
    if not 1 <= count <= SEEDS:
        raise InputError(f"--seeds {count}; give a number from 1 to {SEEDS}")
    return count
