"""Command line: ``python -m research.published``."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, run_command_and_return_exit_code
from research.campaign import Campaign, PageBlock, Plain, add_workers_option, check_workers_option
from research.published import guide, rerun
from research.published.results import EMPTY, PublishedResults
from research.published.runner import (
    Length,
    ResultsWithReport,
    entries_text,
    run_comparison,
    summarise_results,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> ResultsWithReport:
    """Return results and report after the selected runs."""
    check_workers_option(options)
    names: tuple[Length, ...] = ("quick", "full", "check")
    length = next((name for name in names if getattr(options, name)), None)
    return run_comparison(Path(options.out), length, workers=options.workers, progress=not options.quiet)


def keys_of_stale_series(options: Any) -> Sequence[str]:
    """Return the series whose short reference runs the present code does not reproduce."""
    return [key for key, item in run(options).results.series.items() if item.get("stale")]


def from_plain(plain: Any) -> ResultsWithReport:
    """Return results from the data of a file."""
    return ResultsWithReport(PublishedResults.from_plain(plain))


def report_data(shown: ResultsWithReport) -> Plain:
    """Return the data of ``report.json``."""
    return shown.report or summarise_results(shown.results)


def entries_text_and_agreement_count(shown: ResultsWithReport) -> str:
    """Return the entries as a table, and the number of agreements."""
    return entries_text(report_data(shown))


def blocks(shown: ResultsWithReport) -> Mapping[str, PageBlock]:
    """Return the blocks of README and guide."""
    return guide.guide_blocks(shown.results)


def pictures(shown: ResultsWithReport) -> Mapping[str, Figure]:
    """Return the picture of both causes of the hysteresis, if they were run."""
    from research.published.plots import draw_both_causes_figure

    drawing = draw_both_causes_figure(shown.results)
    return {} if drawing is None else {"docs/images/hysteresis.png": drawing}


def add_options(item: Parser) -> None:
    """Add the options for a single entry and for the number of processes."""
    item.add_argument(
        "--only",
        metavar="KEY",
        help="repeat the runs behind one entry, and compare every figure with the file",
    )
    add_workers_option(item, None, "all processors")


def rerun_selected_entry(options: Any) -> tuple[Plain, str] | None:
    """Return one repeated entry compared with the file, if selected."""
    check_workers_option(options)
    if options.only is None:
        return None
    again = rerun.repeat_entry_and_compare(options.only, workers=options.workers, progress=not options.quiet)
    return again, rerun.comparison_text(again)


CAMPAIGN = Campaign(
    name="published",
    purpose="De Paula's published values compared with ours, with verdicts.",
    quick="run the short cases, in minutes",
    full="run cases missing in the committed results, in hours",
    run=run,
    from_plain=from_plain,
    empty=ResultsWithReport(EMPTY),
    text=entries_text_and_agreement_count,
    summary=report_data,
    blocks=blocks,
    pictures=pictures,
    add_options=add_options,
    instead=rerun_selected_entry,
    show=run,
    stale=keys_of_stale_series,
    examples="""\
examples:
  %(prog)s                  # shows the committed results, and writes report.html
  %(prog)s --quick -o out/published""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
