"""Command line: ``python -m validation melting``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from granular.shared.console import add_output, emit
from granular.shared.errors import InputError

DIRECTORY = "out/melting"
RESULTS = "results.json"


def add_melting(one: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    one.add_argument(
        "-o", "--out", metavar="DIR", default=DIRECTORY,
        help=f"directory for runs and results; what was run is found again ({DIRECTORY} if not "
        "given)",
    )  # fmt: skip
    length = one.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="three layers of 256 grains, seconds")
    length.add_argument(
        "--full", action="store_true",
        help="layers of 4096 grains at fifteen temperatures, in an hour; without any of these "
        "nothing is run",
    )  # fmt: skip
    length.add_argument(
        "--guide", action="store_true",
        help="write table and picture of the results that come with the package into the guide",
    )  # fmt: skip
    one.add_argument("--workers", type=int, default=2, metavar="N", help="processes (2)")
    add_output(one)


def run_melting(options: Any) -> None:
    """Run the command."""
    from validation.melting.results import committed, results_of, write_results
    from validation.melting.running import FULL, QUICK, run_plan
    from validation.melting.text import summary, text

    if options.workers < 1:
        raise InputError(f"--workers {options.workers}; give 1 or more")
    if options.guide:
        from validation.melting.guide import write_guide

        pages = [str(path) for path in write_guide(committed())]
        emit({"pages": pages}, "written: " + ", ".join(pages), options.json)
        return
    if not (options.quick or options.full):
        found = committed()
        emit(summary(found), text(found), options.json)
        return
    plan, where = QUICK if options.quick else FULL, Path(options.out)
    layers = run_plan(plan, where, workers=options.workers, progress=not options.quiet)
    length = "--quick" if options.quick else "--full"
    found = results_of(layers, f"python -m validation melting {length}")
    write_results(found, where / RESULTS)
    emit(summary(found), f"{text(found)}\nresults: {where / RESULTS}", options.json)
