"""Command line: ``python -m research.recovery``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from granular.commands.console import Parser, launch
from research.campaign import Block, Campaign, Plain
from research.recovery.text import recovery_markdown, recovery_text


def run(options: Any) -> Plain:
    """Return the rows of all systems."""
    from research.recovery.runner import recovery

    return recovery(options.out, full=options.full, progress=not options.quiet)


def blocks(result: Plain) -> Mapping[str, Block]:
    """Return the table for the guide."""
    return {"table": Block("docs/results/real-records.md", recovery_markdown(result))}


def add_options(item: Parser) -> None:
    """Add the option for a file of the Silverbox benchmark."""
    item.add_argument(
        "--silverbox",
        metavar="FILE",
        help="fit this file of the Silverbox benchmark instead, with the columns V1 (in) and V2 (out)",
    )


def instead(options: Any) -> tuple[Plain, str] | None:
    """Return the errors of laws on the Silverbox record if its file is given."""
    if options.silverbox is None:
        return None
    from research.recovery.silverbox import silverbox, silverbox_text

    result = silverbox(options.silverbox)
    return result, silverbox_text(result)


CAMPAIGN: Campaign[Plain] = Campaign(
    name="recovery",
    purpose="Fraction of fits that reach the true optimum, compared with SciPy.",
    quick="one level of noise and one seed, in minutes",
    full="four levels of noise and five seeds, in an hour",
    run=run,
    from_plain=dict,
    empty={},
    text=recovery_text,
    summary=dict,
    blocks=blocks,
    add_options=add_options,
    instead=instead,
    examples="""\
examples:
  %(prog)s --full -o out/recovery     # an hour; resumes an interrupted run
  %(prog)s --silverbox SNLS80mV.csv""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(launch(CAMPAIGN.main))
