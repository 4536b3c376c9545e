"""Command line: ``python -m research.melting``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, launch
from research.campaign import RESULTS, Block, Campaign, add_workers, checked_workers, write_results
from research.melting.results import Results, from_plain, results_of, to_plain
from research.melting.text import markdown, summary, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> Results:
    """Return the results of the selected layers."""
    from research.melting.layer_runs import FULL, QUICK, run_plan

    checked_workers(options)
    plan, directory = QUICK if options.quick else FULL, Path(options.out)
    layers = run_plan(plan, directory, workers=options.workers, progress=not options.quiet)
    length = "--quick" if options.quick else "--full"
    result = results_of(layers, f"python -m research.melting {length}")
    write_results(to_plain(result), directory / RESULTS)
    return result


def blocks(results: Results) -> Mapping[str, Block]:
    """Return the table and the transitions for the guide."""
    return {"table": Block("docs/results/melting-and-disorder.md", markdown(results))}


def pictures(results: Results) -> Mapping[str, Figure]:
    """Return the picture for the guide."""
    from research.melting.picture import draw

    return {"docs/images/melting.png": draw(results)}


def add_options(item: Parser) -> None:
    """Add the option for the number of processes."""
    add_workers(item, 2, "2")


CAMPAIGN = Campaign(
    name="melting",
    purpose="Melting of a layer of dipoles: interaction parameters at which it loses its order.",
    quick="three layers of 256 grains, seconds",
    full="layers of 4096 grains at fifteen temperatures, in an hour",
    run=run,
    from_plain=from_plain,
    empty=Results({}, ()),
    text=text,
    summary=summary,
    blocks=blocks,
    pictures=pictures,
    add_options=add_options,
    examples="""\
examples:
  %(prog)s                          # shows the committed results
  %(prog)s --quick -o out/melting""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(launch(CAMPAIGN.main))
