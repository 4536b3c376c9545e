"""Command line: ``python -m research.measured``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import run_command_and_return_exit_code
from research.campaign import (
    RESULTS,
    Campaign,
    PageBlock,
    Plain,
    command_date_and_versions,
    round_floats_in_plain_data,
    write_results,
)
from research.measured.text import tables_markdown_by_block, tables_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUICK, FULL = (0.0, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of small magnets."""


def run(options: Any) -> Plain:
    """Simulate mixtures under one load, and dampers of five sizes."""
    from research.measured.measurements import voronoi_and_order_means_of_mixture
    from research.measured.sizes import figures_of_dampers_of_same_magnets, figures_of_rescaled_beds

    beds = Path(options.out) / "beds"
    ratios, seeds = (FULL, 2) if options.full else (QUICK, 1)
    result = {
        "made": command_date_and_versions(
            f"python -m research.measured {'--full' if options.full else '--quick'}"
        ),
        "mixtures": [voronoi_and_order_means_of_mixture(ratio, seeds) for ratio in ratios],
        "rescaled": list(figures_of_rescaled_beds(beds)),
        "same magnets": list(figures_of_dampers_of_same_magnets(beds)) if options.full else [],
    }
    result = round_floats_in_plain_data(result, 12)
    write_results(result, Path(options.out) / RESULTS)
    return result


def blocks(result: Plain) -> Mapping[str, PageBlock]:
    """Return the tables of the page."""
    return {
        name: PageBlock("docs/results/measurements.md", words)
        for name, words in tables_markdown_by_block(result).items()
    }


def pictures(result: Plain) -> Mapping[str, Figure]:
    """Return the picture of the collapse of sizes."""
    from research.measured.sizes import draw_collapse_of_sizes

    return {"docs/images/sizes.png": draw_collapse_of_sizes(result["rescaled"], result["same magnets"])}


CAMPAIGN: Campaign[Plain] = Campaign(
    name="measured",
    purpose="Public measurements on beds of repelling magnets, and one curve for dampers of all sizes.",
    quick="two mixtures and one bed in five sizes, minutes",
    full="five mixtures of two beds and dampers of five sizes, a quarter of an hour",
    run=run,
    from_plain=dict,
    empty={},
    text=tables_text,
    summary=dict,
    blocks=blocks,
    pictures=pictures,
    examples="""\
examples:
  %(prog)s                          # measurements, published figures, and committed results
  %(prog)s --full -o out/measured   # then --guide writes the page""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
