"""Command line: ``python -m research.recovery``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from granular.commands.console import run_command_and_return_exit_code
from research.campaign import Campaign, PageBlock, Plain
from research.recovery.text import table_and_totals_markdown, table_and_totals_text


def run(options: Any) -> Plain:
    """Return the rows of all systems."""
    from research.recovery.runner import run_recovery_study

    return run_recovery_study(options.out, full=options.full, progress=not options.quiet)


def blocks(result: Plain) -> Mapping[str, PageBlock]:
    """Return the table for the guide."""
    return {"table": PageBlock("docs/results/real-records.md", table_and_totals_markdown(result))}


CAMPAIGN: Campaign[Plain] = Campaign(
    name="recovery",
    purpose="Fraction of fits that reach the true optimum, compared with SciPy.",
    quick="one level of noise and one seed, in minutes",
    full="four levels of noise and five seeds, in an hour",
    run=run,
    from_plain=dict,
    empty={},
    text=table_and_totals_text,
    summary=dict,
    blocks=blocks,
    examples="""\
examples:
  %(prog)s --full -o out/recovery     # an hour; resumes an interrupted run""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
