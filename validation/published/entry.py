"""An entry: one published number, how ours is found, and the rule of its verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

from validation.published.finding import Finding
from validation.published.results import Results

WITHIN_SCATTER = "agrees within scatter"
DIFFERS = "differs"
NOT_COMPARABLE = "not comparable"
NOT_RUN = "not run yet"

DEVIATIONS = 2.0
"""Ours agrees within scatter up to so many standard deviations of single starts: for means of three
starts each that is about Student's interval of 95 % of their difference."""


class Rule(NamedTuple):
    """When ours agrees.

    Attributes
    ----------
    relative : float
        Difference over the published value up to which ours agrees when it is outside the scatter.
    absolute : float
        The same difference in the unit of the value; the greater of both counts.
    limit : str
        ``""``; ``"most"`` or ``"least"`` where the source prints a bound.
    comparable : bool
        False where the source's figure depends on something that it does not print, or on its
        machine.
    """

    relative: float = 0.0
    absolute: float = 0.0
    limit: str = ""
    comparable: bool = True


EXACT = Rule()
"""Agreement within scatter and rounding alone."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One published number.

    Attributes
    ----------
    key : str
        Where it stands in ``values.toml``: ``"section.name[place]"``.
    what : str
    measure : callable
        Ours from the results; None where the runs it needs are not there.
    unit : str
    rule : Rule
    spread_key : str
        Where the published standard deviation stands, if one is printed.
    digits : int
        Decimals that are printed.
    covers : tuple of str
        Further keys that say the same.
    note : str
        Why ours differs, or cannot be compared; shown where it does.
    """

    key: str
    what: str
    measure: Callable[[Results], Finding | None]
    unit: str = ""
    rule: Rule = EXACT
    spread_key: str = ""
    digits: int = 2
    covers: tuple[str, ...] = ()
    note: str = ""


class Verdict(NamedTuple):
    """A verdict in a word, and whether it is one of agreement (None: no verdict can be given)."""

    words: str
    agrees: bool | None


def verdict(
    published: float, published_spread: float | None, found: Finding | None, rule: Rule, digits: int
) -> Verdict:
    """Whether ours agrees with the published value.

    Parameters
    ----------
    published, published_spread : float
        NaN or None for a spread that is not printed.
    found : Finding or None
    rule : Rule
    digits : int
        Decimals that are printed: half of the last one is rounding.
    """
    if found is None or not math.isfinite(found.value):
        return Verdict(NOT_RUN, None)
    if not rule.comparable:
        return Verdict(NOT_COMPARABLE, None)
    if rule.limit:
        return _bounded(published, found.value, rule)
    difference = abs(found.value - published)
    if difference <= _scatter(published_spread, found.spread) + 0.5 * 10.0**-digits * 1.000001:
        return Verdict(WITHIN_SCATTER if found.starts else "agrees as printed", True)
    for allowed, words in _tolerances(published, rule):
        if difference <= allowed:
            return Verdict(f"agrees within {words}", True)
    return Verdict(DIFFERS, False)


def _scatter(published: float | None, ours: float | None) -> float:
    known = [one for one in (published, ours) if one is not None and math.isfinite(one)]
    return DEVIATIONS * math.hypot(*known) if known else 0.0


def _bounded(published: float, ours: float, rule: Rule) -> Verdict:
    holds = ours <= published if rule.limit == "most" else ours >= published
    return Verdict("holds" if holds else DIFFERS, holds)


def _tolerances(published: float, rule: Rule) -> list[tuple[float, str]]:
    made = []
    if rule.relative:
        made.append((rule.relative * abs(published), f"{100.0 * rule.relative:g} %"))
    if rule.absolute:
        made.append((rule.absolute, f"{rule.absolute:g}"))
    return sorted(made)
