"""What moves the figures: the same bed with one thing changed."""

from __future__ import annotations

import math
from typing import NamedTuple

from validation.published.finding import Finding
from validation.published.plan import ASPECTS, RADII, mixture_name
from validation.published.protocols import BEST_FIRST
from validation.published.results import Results


class ChangedFigure(NamedTuple):
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
    def matters(self) -> bool | None:
        """Whether the means differ beyond Student's interval of 95 %.

        None where neither bed was run from several starts. A bed with one start is taken to
        scatter like the other one.
        """
        from scipy.special import stdtrit

        both = (self.without, self.with_it)
        known = [(one.starts - 1, one.spread) for one in both if one.spread is not None]
        if not known:
            return None
        free = sum(number for number, _ in known)
        pooled = math.sqrt(sum(number * spread**2 for number, spread in known) / free)
        error = pooled * math.sqrt(sum(1.0 / one.starts for one in both))
        difference = abs(self.with_it.value - self.without.value)
        return bool(difference > stdtrit(free, 0.975) * error)


_FIGURES = {
    "force": ("piston force", "N"),
    "half_full_D": ("half mean distance", "D"),
    "half_start_D": ("half mean distance at the start", "D"),
    "least_distance_D": ("least distance to the piston", "D"),
    "hexagons_full": ("share of hexagons", ""),
    "psi6_full": ("Psi6", ""),
    "regularity_full": ("hexagon regularity", ""),
    "regularity_start": ("hexagon regularity at the start", ""),
}
_BED_FIGURES = ("force", "half_full_D", "hexagons_full")
_MIXTURE_FIGURES = (
    "force", "least_distance_D", "hexagons_full", "regularity_full", "regularity_start",
)  # fmt: skip


class Change(NamedTuple):
    """A bed with one thing changed.

    Attributes
    ----------
    words : str
    bed, changed : str
        Names of series.
    figures : tuple of str
    """

    words: str
    bed: str
    changed: str
    figures: tuple[str, ...]


_MIXTURES = (mixture_name(0.6, 0.0), *(mixture_name(a, 0.5) for a in ASPECTS))
_CREEPING = (*_MIXTURES, mixture_name(0.6, 1.0))
_MIDDLE = mixture_name(0.6, 0.5)
_STEP, _FRICTION = "a third of the step", "the source's friction law at its step, 1e-6 T"
_WIDE = ("half_start_D", "half_full_D")


def changes() -> list[Change]:
    """All changes, in the order of the report."""
    return [
        Change(_STEP, "direct 368", f"direct 368, {_STEP}", _BED_FIGURES),
        Change(_STEP, _MIDDLE, f"{_MIDDLE}, {_STEP}", _MIXTURE_FIGURES),
        Change(_FRICTION, "direct 368", "direct 368, source's friction", _BED_FIGURES),
        *(Change(_FRICTION, bed, f"source's friction, {bed}", _MIXTURE_FIGURES)
          for bed in _CREEPING),
        Change("drag instead of friction", "direct 368", "drag", _BED_FIGURES),
        *(Change("friction with the misprinted angle (42 times)", mixture_name(a, 0.5),
                 f"misprinted angle, a = {a:g}", _MIXTURE_FIGURES) for a in ASPECTS),
        *(Change("the source's every-k-th mixing", mixture_name(0.6, r),
                 f"every k-th, a = 0.6, R = {r:g}", _MIXTURE_FIGURES) for r in (0.3, 0.4, 0.5)),
        *(Change("plain cut-off at 11.26 D", f"direct {n}", f"cut-off {n}", ("force",))
          for n in (368, 736)),
        *(Change(f"list of radius {radius:g} D", "direct 368", f"list of radius {radius:g} D",
                 ("force",)) for radius in RADII),
        Change("scale of the cell rounded to 0.70", "direct 184", "direct 184, scale 0.70", _WIDE),
        *(Change("cell of 0.36 m, as Table 4.3 prints it", mixture_name(a, 0.5),
                 f"wide cell, a = {a:g}", _MIXTURE_FIGURES) for a in ASPECTS),
    ]  # fmt: skip


def comparisons(results: Results) -> list[ChangedFigure]:
    """Shorter protocols, and all changes, whose runs are there."""
    found: list[ChangedFigure | None] = []
    for name in ("direct 368", "direct 736"):
        found += _lengths(results, name, _BED_FIGURES)
    for name in _MIXTURES:
        found += _lengths(results, name, _MIXTURE_FIGURES)
    for change in changes():
        found += _changed(results, change)
    return [one for one in found if one is not None]


def _lengths(results: Results, name: str, figures: tuple[str, ...]) -> list[ChangedFigure | None]:
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


def _changed(results: Results, change: Change) -> list[ChangedFigure | None]:
    """A changed bed beside the usual one, under the same protocol."""
    protocol = results.best(change.bed, change.changed)
    if protocol is None:
        return []
    return [
        _comparison(change.words, change.bed, figure,
                    _finding(results, change.bed, figure, protocol),
                    _finding(results, change.changed, figure, protocol))
        for figure in change.figures
    ]  # fmt: skip


def _finding(results: Results, name: str, figure: str, protocol: str) -> Finding | None:
    sample = results.sample(name, figure, protocol)
    return None if sample is None else sample.finding()


def _comparison(
    change: str, name: str, figure: str, without: Finding | None, with_it: Finding | None
) -> ChangedFigure | None:
    if without is None or with_it is None:
        return None
    bed = name.replace("direct ", "N = ")
    return ChangedFigure(change, bed, *_FIGURES[figure], without, with_it)
