"""Command line: ``python -m research.benchmarks``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from granular.commands.console import (
    Parser,
    add_version_option,
    print_result,
    run_command_and_return_exit_code,
)
from granular.commands.options import OutputOptions
from granular.commands.signature import add_option_group
from granular.shared.errors import InputError, quote
from research.campaign import RESULTS, write_results


def parser() -> Parser:
    """Grammar of the command line."""
    item = Parser(
        prog="python -m research.benchmarks",
        description="Fit public benchmarks, and print the errors beside the published ones.",
        epilog="example:\n  %(prog)s --data benchmark-files -o out/benchmarks   # writes benchmarks.html",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version_option(item)
    item.add_argument("--data", metavar="DIR", required=True, help="directory of the benchmarks' files")
    item.add_argument("-o", "--out", metavar="DIR", default="out/benchmarks", help="directory of the page")
    item.add_argument("--only", metavar="NAME", action="append", help="run this benchmark only (repeatable)")
    add_option_group(item, OutputOptions)
    return item


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parser().parse_args(arguments)
    from granular.shared.progress_bars import progress_bar
    from research.benchmarks.bouc_wen import BOUC_WEN
    from research.benchmarks.mr_damper import MR_DAMPER
    from research.benchmarks.page import results_as_plain_data, results_page, results_text
    from research.benchmarks.silverbox import SILVERBOX

    folder, out = Path(options.data), Path(options.out)
    if not folder.is_dir():
        raise InputError(
            f"--data {quote(options.data)} is not a directory; give the one of the benchmarks' files"
        )
    known = {item.name: item for item in (BOUC_WEN, MR_DAMPER, SILVERBOX)}
    for name in options.only or ():
        if name not in known:
            raise InputError(
                f"--only {quote(name)} is not a benchmark; give one of {', '.join(map(repr, known))}"
            )
    results = {}
    chosen = [known[name] for name in options.only or known]
    with progress_bar(total=len(chosen), desc="benchmarks", wanted=not options.quiet) as bar:
        for item in chosen:
            results[item] = None if item.missing_files(folder) else item.fit_laws_and_measure_errors(folder)
            bar.update()
    summary = results_as_plain_data(results)
    out.mkdir(parents=True, exist_ok=True)
    results_page(results).save(out / "benchmarks.html")
    write_results(summary, out / RESULTS)
    words = f"{results_text(results)}\n\npage: {out / 'benchmarks.html'}"
    print_result(summary, words, options.json)


if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
