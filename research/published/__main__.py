"""Command line: ``python -m research.published``."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, launch
from research.campaign import Block, Campaign, Plain, add_workers, checked_workers
from research.published import guide, rerun
from research.published.results import EMPTY, Results
from research.published.runner import Length, Shown, compare, summary, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> Shown:
    """Return results and report after the selected runs."""
    checked_workers(options)
    names: tuple[Length, ...] = ("quick", "full", "check")
    length = next((name for name in names if getattr(options, name)), None)
    return compare(Path(options.out), length, workers=options.workers, progress=not options.quiet)


def stale(options: Any) -> Sequence[str]:
    """Return the series whose short reference runs the present code does not reproduce."""
    return [key for key, item in run(options).results.series.items() if item.get("stale")]


def from_plain(plain: Any) -> Shown:
    """Return results from the data of a file."""
    return Shown(Results.from_plain(plain))


def report_of(shown: Shown) -> Plain:
    """Return the data of ``report.json``."""
    return shown.report or summary(shown.results)


def words(shown: Shown) -> str:
    """Return the entries as a table, and the number of agreements."""
    return text(report_of(shown))


def blocks(shown: Shown) -> Mapping[str, Block]:
    """Return the blocks of README and guide."""
    return guide.blocks(shown.results)


def pictures(shown: Shown) -> Mapping[str, Figure]:
    """Return the picture of both causes of the hysteresis, if they were run."""
    from research.published.plots import both_causes_figure

    drawing = both_causes_figure(shown.results)
    return {} if drawing is None else {"docs/images/hysteresis.png": drawing}


def add_options(item: Parser) -> None:
    """Add the options for a single entry and for the number of processes."""
    item.add_argument(
        "--only",
        metavar="KEY",
        help="repeat the runs behind one entry, and compare every figure with the file",
    )
    add_workers(item, None, "all processors")


def instead(options: Any) -> tuple[Plain, str] | None:
    """Return one repeated entry compared with the file, if selected."""
    checked_workers(options)
    if options.only is None:
        return None
    again = rerun.rerun(options.only, workers=options.workers, progress=not options.quiet)
    return again, rerun.text(again)


CAMPAIGN = Campaign(
    name="published",
    purpose="De Paula's published values compared with ours, with verdicts.",
    quick="run the short cases, in minutes",
    full="run cases missing in the committed results, in hours",
    run=run,
    from_plain=from_plain,
    empty=Shown(EMPTY),
    text=words,
    summary=report_of,
    blocks=blocks,
    pictures=pictures,
    add_options=add_options,
    instead=instead,
    show=run,
    stale=stale,
    examples="""\
examples:
  %(prog)s                  # shows the committed results, and writes report.html
  %(prog)s --quick -o out/published""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(launch(CAMPAIGN.main))
