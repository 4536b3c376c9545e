"""Command line: ``python -m research.discovery``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, run_command_and_return_exit_code
from granular.shared.errors import InputError, quote
from research.campaign import Campaign, PageBlock
from research.discovery.cases import NOISES, SEEDS
from research.discovery.results import EMPTY, DiscoveryResults
from research.discovery.runner import run_discovery_study
from research.discovery.text import (
    rates_and_rows_as_plain_data,
    tables_and_summary_markdown,
    tables_and_summary_text,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> DiscoveryResults:
    """Return the results of the selected cases."""
    systems = () if options.systems is None else options.systems.split(",")
    return run_discovery_study(
        options.out,
        quick=options.quick,
        systems=tuple(word.strip() for word in systems),
        noises=_parse_noise_levels(options.noise),
        seeds=_check_seed_count(options.seeds),
        anew=options.anew,
        progress=not options.quiet,
    )


def _parse_noise_levels(words: str | None) -> tuple[float, ...]:
    if words is None:
        return NOISES
    known = {f"{noise:g}": noise for noise in NOISES}
    try:
        return tuple(known[f"{float(word):g}"] for word in words.split(","))
    except (ValueError, KeyError):
        raise InputError(
            f"--noise {quote(words)} is not available; give one or more of {', '.join(known)}"
        ) from None


def _check_seed_count(count: int | None) -> int:
    if count is None:
        return SEEDS
    if not 1 <= count <= SEEDS:
        raise InputError(f"--seeds {count} is outside the limits; give a number from 1 to {SEEDS}")
    return count


def blocks(results: DiscoveryResults) -> Mapping[str, PageBlock]:
    """Return tables and text for the guide."""
    return {"rates": PageBlock("docs/results/discovery.md", tables_and_summary_markdown(results))}


def pictures(results: DiscoveryResults) -> Mapping[str, Figure]:
    """Return the picture for the guide."""
    from research.discovery.picture import draw_found_fractions

    return {"docs/images/discovery.png": draw_found_fractions(results)}


def add_options(item: Parser) -> None:
    """Add the options that select cases."""
    item.add_argument(
        "--systems", metavar="NAME,...", help="some of the systems, such as 'pendulum,two wells'"
    )
    item.add_argument("--noise", metavar="SHARE,...", help="some of 0.001, 0.01, 0.03 and 0.1")
    item.add_argument("--seeds", type=int, metavar="N", help="number of seeds, 1 to 5 (5 if not given)")
    item.add_argument("--anew", action="store_true", help="also run cases that the directory has cached")


CAMPAIGN = Campaign(
    name="discovery",
    purpose="Fraction of laws discovered, compared with PySINDy and pyoperon.",
    quick="three systems, within minutes",
    full="all cases selected by the options, in hours",
    run=run,
    from_plain=DiscoveryResults.from_plain,
    empty=EMPTY,
    text=tables_and_summary_text,
    summary=rates_and_rows_as_plain_data,
    blocks=blocks,
    pictures=pictures,
    add_options=add_options,
    examples="""\
examples:
  %(prog)s                                # shows the committed results
  %(prog)s --full --noise 0.01 --systems "pendulum,two wells"
  %(prog)s --quick -o out/discovery""",
)
parser = CAMPAIGN.parser

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(CAMPAIGN.main))
