"""The command ``response-law``: the law beside a simulated response."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from granular.commands.console import add_output, emit

WHAT = "set the law of the bed beside a machine's simulated response, and write a report"
EXAMPLES = """\
example, after 'response machine ... -o out/machine':
  %(prog)s out/machine"""
REPORT = "report.html"


def add_response_law(one: argparse.ArgumentParser) -> None:
    """The command's grammar."""
    one.add_argument(
        "directory", metavar="DIR", help="what 'response -o DIR' wrote; its report.html is renewed"
    )
    add_output(one)


def run_response_law(options: Any) -> None:
    """Solve the law, say how far off it is, and write the report."""
    from granular.response import load_response
    from reduced_models.machines.beside import law_page

    found = load_response(options.directory)
    page, law, why = law_page(found)
    path = Path(options.directory) / REPORT
    page.save(path)
    rows = [] if law is None else [
        {"force": one.force, "simulated": one.simulated, "law": one.law, "error": one.error,
         "linear": one.linear, "linear_error": one.linear_error, "outside": one.outside or None}
        for one in law.peaks
    ]  # fmt: skip
    lines = [found.table, why] if law is None else [law.table]
    lines += [] if law is None else [
        f"warning: under {one.force:g} N {one.outside}" for one in law.peaks if one.outside
    ]  # fmt: skip
    emit(
        {"peaks": rows, "missing": why or None, "report": str(path)},
        "\n".join([*lines, f"written to {path}"]),
        options.json,
    )
