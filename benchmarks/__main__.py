"""Command line: ``python -m benchmarks``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import PARTS
from granular.commands.console import (
    Parser,
    add_version_option,
    print_result,
    run_command_and_return_exit_code,
)
from granular.commands.options import OutputOptions
from granular.commands.signature import add_option_group
from granular.shared.errors import InputError

EXAMPLES = "\n".join(f"  {name:10}{words}" for name, words in PARTS.items())


def parser() -> Parser:
    """Make the parser of the command line."""
    item = Parser(
        prog="python -m benchmarks",
        description="Comparison of speeds.",
        epilog=f"parts:\n{EXAMPLES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version_option(item)
    item.add_argument(
        "--part",
        dest="parts",
        metavar="PART",
        action="append",
        choices=tuple(PARTS),
        help="measure this part only; see below (repeatable)",
    )
    item.add_argument(
        "--history",
        metavar="FILE",
        help="measure a few kernels only, add their ratios to a plain loop to this file, show the last ones",
    )
    item.add_argument(
        "--prices",
        metavar="FILE",
        help="measure the table behind promised accuracies again, and write it here; "
        "granular/run/work_precision.toml is the table in use",
    )
    item.add_argument(
        "-o", "--out", metavar="DIR", help="directory for the report; results are stored there and reused"
    )
    length = item.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="within a few minutes (default)")
    length.add_argument("--full", action="store_true", help="everything, about an hour")
    add_option_group(item, OutputOptions)
    return item


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parser().parse_args(arguments)
    if options.history is not None:
        _history(options)
    elif options.prices is not None:
        _prices(options)
    else:
        _benchmark(options)


def _benchmark(options: Any) -> None:
    from benchmarks.page import benchmark_text
    from benchmarks.runner import benchmark

    result = benchmark(
        options.out, parts=options.parts or tuple(PARTS), full=options.full, progress=not options.quiet
    )
    location = "" if options.out is None else f"\npage: {options.out}/benchmark.html"
    print_result(result, benchmark_text(result) + location, options.json)


def _history(options: Any) -> None:
    from benchmarks.history import add, history_table, measured, read

    _alone(options, "--history")
    path = Path(options.history)
    read(path)  # fails before minutes are spent
    entries = add(path, measured())
    print_result(entries[-1], [history_table(entries)], options.json)


def _prices(options: Any) -> None:
    from benchmarks.costs import costs, prices_text

    _alone(options, "--prices")
    result = costs(Path(options.prices), progress=not options.quiet)
    print_result(result, prices_text(result), options.json)


def _alone(options: Any, name: str) -> None:
    both = options.history is not None and options.prices is not None
    if both or options.parts or options.out is not None or options.full:
        others = "--part, --out, --full and " + ("--prices" if name == "--history" else "--history")
        raise InputError(f"{name} has a fixed extent; omit {others}")


if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
