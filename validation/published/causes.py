"""What moves the figures: the same bed with one thing changed."""

from __future__ import annotations

import math
from typing import NamedTuple

from validation.published.entry import DEVIATIONS, Finding
from validation.published.plan import ASPECTS, RADII, mixture_name
from validation.published.protocols import BEST_FIRST, PUBLISHED, QUICK, SHORT
from validation.published.results import Results


class Comparison(NamedTuple):
    """A figure of one bed with and without a change.

    Attributes
    ----------
    change, bed, figure, unit : str
    without, with_it : Finding
    """

    change: str
    bed: str
    figure: str
    unit: str
    without: Finding
    with_it: Finding

    @property
    def matters(self) -> bool:
        """Whether the change moves the figure by more than the scatter of the starts."""
        spreads = [one.spread for one in (self.without, self.with_it) if one.spread is not None]
        # Of the difference of two means.
        error = math.hypot(*(s / math.sqrt(3.0) for s in spreads)) if spreads else 0.0
        return abs(self.with_it.value - self.without.value) > DEVIATIONS * error


_FIGURES = {
    "force": ("piston force", "N"),
    "half_full_D": ("half mean distance", "D"),
    "half_start_D": ("half mean distance at the start", "D"),
    "least_distance_D": ("least distance to the piston", "D"),
    "hexagons_full": ("share of hexagons", ""),
    "psi6_full": ("Psi6", ""),
    "regularity_full": ("hexagon regularity", ""),
}
_BED_FIGURES = ("force", "half_full_D", "hexagons_full")
_MIXTURE_FIGURES = ("force", "least_distance_D", "hexagons_full", "regularity_full")


def comparisons(results: Results) -> list[Comparison]:
    """All comparisons whose runs are there."""
    found: list[Comparison | None] = []
    for name in ("direct 368", "direct 736"):
        found += _lengths(results, name, _BED_FIGURES)
    for name in (mixture_name(0.6, 0.0), *(mixture_name(a, 0.5) for a in ASPECTS)):
        found += _lengths(results, name, _MIXTURE_FIGURES)
    found += _changes(
        results,
        "a third of the step",
        "direct 368",
        "direct 368, a third of the step",
        _BED_FIGURES,
    )
    middle = mixture_name(0.6, 0.5)
    found += _changes(
        results, "a third of the step", middle, f"{middle}, a third of the step", _MIXTURE_FIGURES
    )
    found += _changes(
        results,
        "the source's regularised friction",
        "direct 368",
        "direct 368, regularised friction",
        _BED_FIGURES,
    )
    found += _changes(
        results,
        "scale of the cell rounded to 0.70",
        "direct 184",
        "direct 184, scale 0.70",
        ("half_full_D", "half_start_D"),
    )
    found += _changes(results, "drag instead of friction", "direct 368", "drag", _BED_FIGURES)
    for n in (368, 736):
        found += _changes(
            results, "plain cut-off at 11.26 D", f"direct {n}", f"cut-off {n}", ("force",)
        )
    for radius in RADII:
        found += _changes(
            results,
            f"list of radius {radius:g} D",
            "direct 368",
            f"list of radius {radius:g} D",
            ("force",),
        )
    for ratio in (0.3, 0.4, 0.5):
        found += _changes(
            results,
            "the source's every-k-th mixing",
            mixture_name(0.6, ratio),
            f"every k-th, a = 0.6, R = {ratio:g}",
            _MIXTURE_FIGURES,
        )
    for a in ASPECTS:
        found += _changes(
            results,
            "friction with the misprinted angle (42 times)",
            mixture_name(a, 0.5),
            f"misprinted angle, a = {a:g}",
            _MIXTURE_FIGURES,
        )
    return [one for one in found if one is not None]  # fmt: skip


def _lengths(results: Results, name: str, figures: tuple[str, ...]) -> list[Comparison | None]:
    """Every shorter protocol against the longest one that was run."""
    there = [p for p in BEST_FIRST if results.sample(name, "force", p) is not None]
    if len(there) < 2:
        return []
    return [
        _comparison(f"{protocol} protocol instead of the {there[0]} one", name, figure,
                    _finding(results, name, figure, there[0]),
                    _finding(results, name, figure, protocol))
        for protocol in there[1:]
        for figure in figures
    ]  # fmt: skip


def _changes(
    results: Results, change: str, name: str, other: str, figures: tuple[str, ...]
) -> list[Comparison | None]:
    """A changed bed against the usual one, under the protocol of the changed one."""
    for protocol in (PUBLISHED.name, SHORT.name, QUICK.name):
        if results.sample(other, "force", protocol) is not None:
            return [
                _comparison(change, name, figure, _finding(results, name, figure, protocol),
                            _finding(results, other, figure, protocol))
                for figure in figures
            ]  # fmt: skip
    return []


def _finding(results: Results, name: str, figure: str, protocol: str) -> Finding | None:
    sample = results.sample(name, figure, protocol)
    return None if sample is None else sample.finding()


def _comparison(
    change: str, name: str, figure: str, without: Finding | None, with_it: Finding | None
) -> Comparison | None:
    if without is None or with_it is None:
        return None
    bed = name.replace("direct ", "N = ")
    return Comparison(change, bed, *_FIGURES[figure], without, with_it)
