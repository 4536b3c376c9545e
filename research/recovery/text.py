"""Results of the recovery suite as text and tables, for the console and for a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from granular.shared.blocks import Table
from research.campaign import markdown_of_console_table
from research.recovery.peer import MOST_CALLS
from research.recovery.systems import REACHED

_HEADER = (
    "system",
    "reached",
    "worst residual/noise",
    "starts that agree",
    "CPU s",
    "SciPy's fits that reached",
    "SciPy's starts that reached",
    "SciPy's starts that were stopped",
    "CPU s per start of SciPy",
)


def table_and_totals_text(result: Mapping[str, Any]) -> str:
    """Return the table, and the totals as text."""
    if not result:
        return "no results are committed; run it with --quick or --full"
    return f"{_table_of_systems(result)}\n{_totals_text(result)}"


def table_and_totals_markdown(result: Mapping[str, Any]) -> str:
    """Return table and totals for a page, with command and date."""
    made = result["made"]
    by = f"`{made['command']}` on {made['date']}, {made['cores']} cores, {made['processor']}"
    return f"{markdown_of_console_table(_table_of_systems(result))}\n\n{_totals_text(result)}\n({by}.)"


def _table_of_systems(result: Mapping[str, Any]) -> Table:
    rows = [
        (
            row["system"],
            f"{row['reached']} of {row['fits']}",
            f"{row['worst']:.3f}",
            f"{100 * row['starts that agree']:.0f} %",
            f"{row['seconds']:.2f}",
            f"{row['SciPy reached']} of {row['SciPy fits']}",
            f"{100 * row['SciPy starts that reach it']:.0f} %",
            _stopped_starts_text(row),
            f"{row['SciPy seconds a start']:.2f}",
        )
        for row in result["rows"]
    ]
    return Table(_HEADER, rows)


def _totals_text(result: Mapping[str, Any]) -> str:
    words = (
        f"{result['reached']} of {result['fits']} fits have a residual of at most {REACHED} times the "
        f"noise. {result['wrongly agreed']} fits with a larger residual report that all starts agree."
    )
    if any(row["SciPy starts stopped"] for row in result["rows"]):
        words += f"\nEach fit by SciPy is stopped after {MOST_CALLS} evaluations of the law per sample."
    return words


def _stopped_starts_text(row: Mapping[str, Any]) -> str:
    """Return the text on the number of SciPy's starts that were stopped, and after how many calls."""
    if not row["SciPy starts stopped"]:
        return "none"
    return (
        f"{row['SciPy starts stopped']} of {row['SciPy starts']} at {row['SciPy calls when stopped']:,} calls"
    )
