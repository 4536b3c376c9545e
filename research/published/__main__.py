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
    """Results and report, after the runs that are asked for."""
    checked_workers(options)
    names: tuple[Length, ...] = ("quick", "full", "check")
    length = next((name for name in names if getattr(options, name)), None)
    return compare(Path(options.out), length, workers=options.workers, progress=not options.quiet)


def stale(options: Any) -> Sequence[str]:
    """Series whose short references today's code does not give."""
    return [key for key, item in run(options).results.series.items() if item.get("stale")]


def from_plain(plain: Any) -> Shown:
    """From what a file holds."""
    return Shown(Results.from_plain(plain))


def report_of(shown: Shown) -> Plain:
    """What ``report.json`` holds."""
    return shown.report or summary(shown.results)


def words(shown: Shown) -> str:
    """The entries as a table, and how many agree."""
    return text(report_of(shown))


def blocks(shown: Shown) -> Mapping[str, Block]:
    """Blocks of README and guide."""
    return guide.blocks(shown.results)


def pictures(shown: Shown) -> Mapping[str, Figure]:
    """The picture of both causes of the hysteresis, once they are run."""
    from research.published.plots import both_causes_figure

    drawing = both_causes_figure(shown.results)
    return {} if drawing is None else {"docs/images/hysteresis.png": drawing}


def add_options(item: Parser) -> None:
    """One entry instead of all, and how many processes."""
    item.add_argument(
        "--only",
        metavar="KEY",
        help="run what is behind one entry anew, and compare every figure with the file's",
    )
    add_workers(item, None, "all processors")


def instead(options: Any) -> tuple[Plain, str] | None:
    """One entry run anew beside the file's, where it is asked for."""
    checked_workers(options)
    if options.only is None:
        return None
    again = rerun.rerun(options.only, workers=options.workers, progress=not options.quiet)
    return again, rerun.text(again)


CAMPAIGN = Campaign(
    name="published",
    purpose="De Paula's published values beside ours, with verdicts.",
    quick="run the short cases, in minutes",
    full="run what the committed results lack, in hours",
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
