"""Command line: ``python -m validation disorder``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from granular.shared.console import add_output, emit
from granular.shared.files import make_directory
from validation.defects.results import STUDIES

DIRECTORY = "out/disorder"


def add_defects(one: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    one.add_argument(
        "question", choices=tuple(STUDIES),
        help="what temperature is; forces at defects; the plastic strain that dislocations carry",
    )  # fmt: skip
    one.add_argument(
        "--full", action="store_true",
        help="run all beds, in ten minutes; without it the results of the package are shown",
    )  # fmt: skip
    one.add_argument(
        "-o", "--out", metavar="DIR", default=DIRECTORY,
        help=f"directory for results; what was run is found again ({DIRECTORY} if not given)",
    )  # fmt: skip
    add_output(one)


def run_defects(options: Any) -> None:
    """Run the command."""
    from validation.defects.results import committed, write
    from validation.defects.text import TEXTS, summary

    question = options.question
    if not options.full:
        rows = committed(question)["rows"]
        emit(summary(question, rows), TEXTS[question](rows), options.json)
        return
    out = Path(options.out)
    make_directory(out)
    rows = STUDIES[question](out, not options.quiet)
    path = out / f"{question}.json"
    write(question, rows, path)
    text = f"{TEXTS[question](rows)}\nresults: {path}"
    emit(summary(question, rows), text, options.json)
