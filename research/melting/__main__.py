"""Command line: ``python -m research.melting``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, run_command_and_return_exit_code
from research.campaign import (
    RESULTS,
    Campaign,
    PageBlock,
    add_workers_option,
    check_workers_option,
    write_results,
)
from research.melting.results import MeltingResults, make_results, results_from_plain, results_to_plain
from research.melting.text import results_as_plain_data, table_and_transitions_markdown, table_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> MeltingResults:
    """Return the results of the selected layers."""
    from research.melting.layer_runs import FULL, QUICK, run_all_layers

    check_workers_option(options)
    plan, directory = QUICK if options.quick else FULL, Path(options.out)
    layers = run_all_layers(plan, directory, workers=options.workers, progress=not options.quiet)
    length = "--quick" if options.quick else "--full"
    result = make_results(layers, f"python -m research.melting {length}")
    write_results(results_to_plain(result), directory / RESULTS)
    return result


def blocks(results: MeltingResults) -> Mapping[str, PageBlock]:
    """Return the table and the transitions for the guide."""
    return {
        "table": PageBlock("docs/results/melting-and-disorder.md", table_and_transitions_markdown(results))
    }


def pictures(results: MeltingResults) -> Mapping[str, Figure]:
    """Return the picture for the guide."""
    from research.melting.picture import draw_layers_and_transitions

    return {"docs/images/melting.png": draw_layers_and_transitions(results)}


def add_options(item: Parser) -> None:
    """Add the option for the number of processes."""
    add_workers_option(item, 2, "2")


CAMPAIGN = Campaign(
    name="melting",
    purpose="Melting of a layer of dipoles: interaction parameters at which it loses its order.",
    quick="three layers of 256 grains, seconds",
    full="layers of 4096 grains at fifteen temperatures, in an hour",
    run=run,
    from_plain=results_from_plain,
    empty=MeltingResults({}, ()),
    text=table_text,
    summary=results_as_plain_data,
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
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
