"""Command line: ``python -m research.measured``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import launch
from research.campaign import RESULTS, Block, Campaign, Plain, made_now, rounded, write_results
from research.measured.text import markdown, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUICK, FULL = (0.0, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of small magnets."""


def run(options: Any) -> Plain:
    """Simulate mixtures under one load, and dampers of five sizes."""
    from research.measured.measurements import cells_of_mixture
    from research.measured.sizes import of_same_magnets, rescaled

    beds = Path(options.out) / "beds"
    ratios, seeds = (FULL, 2) if options.full else (QUICK, 1)
    result = {
        "made": made_now(f"python -m research.measured {'--full' if options.full else '--quick'}"),
        "mixtures": [cells_of_mixture(ratio, seeds) for ratio in ratios],
        "rescaled": list(rescaled(beds)),
        "same magnets": list(of_same_magnets(beds)) if options.full else [],
    }
    result = rounded(result, 12)
    write_results(result, Path(options.out) / RESULTS)
    return result


def blocks(result: Plain) -> Mapping[str, Block]:
    """Return the tables of the page."""
    return {name: Block("docs/results/measurements.md", words) for name, words in markdown(result).items()}


def pictures(result: Plain) -> Mapping[str, Figure]:
    """Return the picture of the collapse of sizes."""
    from research.measured.sizes import draw

    return {"docs/images/sizes.png": draw(result["rescaled"], result["same magnets"])}


CAMPAIGN: Campaign[Plain] = Campaign(
    name="measured",
    purpose="Public measurements on beds of repelling magnets, and one curve for dampers of all sizes.",
    quick="two mixtures and one bed in five sizes, minutes",
    full="five mixtures of two beds and dampers of five sizes, a quarter of an hour",
    run=run,
    from_plain=dict,
    empty={},
    text=text,
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
    sys.exit(launch(CAMPAIGN.main))
