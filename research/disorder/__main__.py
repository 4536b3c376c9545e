"""Command line: ``python -m research.disorder``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, run_command_and_return_exit_code
from research.campaign import Campaign, PageBlock
from research.disorder.results import STUDIES, Results, results_from_plain, run_studies
from research.disorder.text import TEXTS, results_as_plain_data, results_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "docs/results/melting-and-disorder.md"


def run(options: Any) -> Results:
    """Return the results of the selected questions from new runs."""
    return run_studies(
        tuple(STUDIES) if options.question is None else (options.question,),
        Path(options.out),
        quick=options.quick,
        progress=not options.quiet,
    )


def show(options: Any) -> Results:
    """Return the committed results of the selected questions."""
    result = CAMPAIGN.read_committed_results()
    return result if options.question is None else {options.question: result[options.question]}


def blocks(results: Results) -> Mapping[str, PageBlock]:
    """Return the tables of the guide."""
    made = {name: TEXTS[name](results[name]["rows"]).strip() for name in TEXTS}
    return {
        "temperature": PageBlock(PAGE, made["temperature"]),
        "forces and slip": PageBlock(PAGE, f"{made['forces']}\n\n{made['slip']}"),
    }


def pictures(results: Results) -> Mapping[str, Figure]:
    """Return the pictures of the guide."""
    from research.disorder.pictures import draw_orders_and_skills, draw_unevenness_and_cycle

    rows = {name: item["rows"] for name, item in results.items()}
    return {
        "docs/images/temperature.png": draw_orders_and_skills(rows["temperature"]),
        "docs/images/forces-and-slip.png": draw_unevenness_and_cycle(rows["forces"], rows["slip"]),
    }


def add_options(item: Parser) -> None:
    """Add the argument for a question; all questions if none is given."""
    item.add_argument(
        "question",
        nargs="?",
        choices=tuple(STUDIES),
        help="definition of temperature; forces at defects; strain by dislocations (all if not given)",
    )


CAMPAIGN: Campaign[Results] = Campaign(
    name="disorder",
    purpose="Temperature of beds, forces at defects, slip by dislocations.",
    quick="a few beds per question, within minutes",
    full="all beds, ten minutes per question",
    run=run,
    from_plain=results_from_plain,
    empty={},
    text=results_text,
    summary=results_as_plain_data,
    blocks=blocks,
    pictures=pictures,
    add_options=add_options,
    show=show,
    examples="""\
examples:
  %(prog)s temperature             # shows the committed results
  %(prog)s slip --full             # ten minutes; resumes an interrupted run""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
