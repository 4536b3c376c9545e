"""The option ``--response`` of ``compare``: the identified law compared with a simulated shaken machine."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from granular.commands.console import print_result
from granular.commands.options import OutputOptions
from granular.response import load_response
from granular.shared.blocks import Block, Text
from reduced_models.machines.response import response_page_comparison_and_reason


def compare_response_with_law(directory: str, output: OutputOptions) -> None:
    """Solve the law, print its errors, and write the report."""
    response = load_response(directory)
    page, law, why = response_page_comparison_and_reason(response)
    path = Path(directory) / "report.html"
    page.save(path)
    peaks = () if law is None else law.peaks
    rows = [
        dataclasses.asdict(peak)
        | {"error": peak.law_peak_error, "linear_error": peak.linear_peak_error}
        | {"outside": peak.outside or None}
        for peak in peaks
    ]
    blocks: list[Block] = [response.table, Text(why)] if law is None else [law.peak_table]
    blocks += [Text(f"warning: under {peak.force:g} N {peak.outside}") for peak in peaks if peak.outside]
    print_result(
        {"peaks": rows, "missing": why or None, "report": str(path)},
        [*blocks, Text(f"written to {path}")],
        output.json,
    )
