"""Command line: ``python -m validation published``."""

from __future__ import annotations

import argparse
from typing import Any

from granular.shared.console import add_output, emit
from granular.shared.errors import InputError

DIRECTORY = "out/published"


def add_published(one: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    one.add_argument(
        "-o", "--out", metavar="DIR", default=DIRECTORY,
        help="directory for cases, results and report; what was run is found again "
        f"({DIRECTORY} if not given)",
    )  # fmt: skip
    length = one.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="run the short cases, in minutes")
    length.add_argument(
        "--full", action="store_true",
        help="run everything, in hours; without --quick and --full nothing is run",
    )  # fmt: skip
    one.add_argument("--workers", type=int, metavar="N", help="processes (all processors)")
    add_output(one)


def run_published(options: Any) -> None:
    """Run the command."""
    from validation.published.programme import Length, published, text

    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give 1 or more")
    length: Length | None = "quick" if options.quick else "full" if options.full else None
    found = published(options.out, length, workers=options.workers, progress=not options.quiet)
    emit(found, f"{text(found)}\nreport: {options.out}/report.html", options.json)
