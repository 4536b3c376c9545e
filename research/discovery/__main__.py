"""Command line: ``python -m research.discovery``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, launch
from granular.shared.errors import InputError, quote
from research.campaign import Block, Campaign
from research.discovery.cases import NOISES, SEEDS
from research.discovery.results import EMPTY, Results
from research.discovery.runner import discovery
from research.discovery.text import markdown, summary, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(options: Any) -> Results:
    """Return the results of the selected cases."""
    systems = () if options.systems is None else options.systems.split(",")
    return discovery(
        options.out,
        quick=options.quick,
        systems=tuple(word.strip() for word in systems),
        noises=_noises(options.noise),
        seeds=_seeds(options.seeds),
        anew=options.anew,
        progress=not options.quiet,
    )


def _noises(words: str | None) -> tuple[float, ...]:
    if words is None:
        return NOISES
    known = {f"{noise:g}": noise for noise in NOISES}
    try:
        return tuple(known[f"{float(word):g}"] for word in words.split(","))
    except (ValueError, KeyError):
        raise InputError(f"--noise {quote(words)}; give some of {', '.join(known)}") from None


def _seeds(count: int | None) -> int:
    if count is None:
        return SEEDS
    if not 1 <= count <= SEEDS:
        raise InputError(f"--seeds {count}; give a number from 1 to {SEEDS}")
    return count


def blocks(results: Results) -> Mapping[str, Block]:
    """Return tables and text for the guide."""
    return {"rates": Block("docs/results/discovery.md", markdown(results))}


def pictures(results: Results) -> Mapping[str, Figure]:
    """Return the picture for the guide."""
    from research.discovery.picture import draw

    return {"docs/images/discovery.png": draw(results)}


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
    from_plain=Results.from_plain,
    empty=EMPTY,
    text=text,
    summary=summary,
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
    sys.exit(launch(CAMPAIGN.main))
