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
        help="run what the results that come with the package lack, in hours; without any of these "
        "nothing is run",
    )  # fmt: skip
    length.add_argument(
        "--check", action="store_true",
        help="run short references alone, and show which results today's code no longer gives",
    )  # fmt: skip
    length.add_argument(
        "--only", metavar="KEY",
        help="run what is behind one entry anew, and compare every figure with the file's",
    )  # fmt: skip
    length.add_argument(
        "--guide", action="store_true",
        help="write the figures of the results that come with the package into the guide",
    )  # fmt: skip
    one.add_argument("--workers", type=int, metavar="N", help="processes (all processors)")
    add_output(one)


def run_published(options: Any) -> None:
    """Run the command."""
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give 1 or more")
    if options.only is not None:
        from validation.published import rerun

        again = rerun.rerun(options.only, workers=options.workers, progress=not options.quiet)
        emit(again, rerun.text(again), options.json)
        return
    if options.guide:
        from validation.published.guide import write_guide
        from validation.published.results import committed

        pages = [str(path) for path in write_guide(committed())]
        emit({"pages": pages}, "written: " + ", ".join(pages), options.json)
        return
    from validation.published.programme import Length, published, text

    names: tuple[Length, ...] = ("quick", "full", "check")
    length = next((name for name in names if getattr(options, name)), None)
    found = published(options.out, length, workers=options.workers, progress=not options.quiet)
    emit(found, f"{text(found)}\nreport: {options.out}/report.html", options.json)
