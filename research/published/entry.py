"""An entry: one published number, how ours is found, and the rule of its verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

from research.published.finding import Finding
from research.published.results import Results

AGREES = "agrees"
DIFFERS = "differs"
BY_CONSTRUCTION = "by construction"
NOT_COMPARABLE = "not comparable"
NOT_RUN = "not run"
VERDICTS = (AGREES, DIFFERS, BY_CONSTRUCTION, NOT_COMPARABLE, NOT_RUN)

CONFIDENCE = 0.95
"""Of the interval of a difference: outside of it means differ."""

PUBLISHED_STARTS = 3
"""Runs behind a published deviation [D, Tables 3.2, 5.2, A.2]."""

SHARP = 0.1
"""A comparison can fail if its interval is narrower than this part of the published value."""


class Rule(NamedTuple):
    """How a comparison is judged.

    Attributes
    ----------
    limit : str
        ``""``; ``"most"`` or ``"least"`` where de Paula prints a bound.
    comparable : bool
        False where de Paula's figure depends on something that it does not print, or on its
        machine.
    constructed : bool
        True where ours was made from the published number, so that it cannot differ.
    scale : float
        Size that the interval of a number near zero is measured by; 0 for the published value.
    """

    limit: str = ""
    comparable: bool = True
    constructed: bool = False
    scale: float = 0.0


PLAIN = Rule()
"""Means by Welch's interval; numbers without scatter by their printed digits."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One published number.

    Attributes
    ----------
    key : str
        Where it stands in ``published.toml``: ``"section.name[place]"``.
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
    rule: Rule = PLAIN
    spread_key: str = ""
    digits: int = 2
    covers: tuple[str, ...] = ()
    note: str = ""


class Verdict(NamedTuple):
    """A verdict.

    Attributes
    ----------
    words : str
        One of `VERDICTS`.
    allowed : float or None
        The difference up to which ours would agree; None where that is not asked.
    can_fail : bool
        Whether that is less than `SHARP` of the published value, or of the rule's scale.
    """

    words: str
    allowed: float | None = None
    can_fail: bool = False

    @property
    def agrees(self) -> bool | None:
        """None where no verdict of agreement or difference was given."""
        return {AGREES: True, DIFFERS: False}.get(self.words)


def verdict(
    published: float, published_spread: float | None, found: Finding | None, rule: Rule, digits: int
) -> Verdict:
    """Whether ours differs from the published value.

    The difference of two means is judged by Student's interval of 95 % with the standard errors of
    both (Welch 1947). A published mean without a deviation has half of its last printed digit for
    an error, and nothing else: what its own scatter was de Paula does not say. Where ours has no
    scatter, the printed digits decide.

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
        return Verdict(NOT_RUN)
    if rule.constructed:
        return Verdict(BY_CONSTRUCTION)
    if not rule.comparable:
        return Verdict(NOT_COMPARABLE)
    allowed = half_width(published_spread, found) + 0.5 * 10.0**-digits * 1.000001
    difference = found.value - published
    if rule.limit:
        beyond = difference if rule.limit == "most" else -difference
        return Verdict(DIFFERS if beyond > allowed else AGREES, allowed, True)
    size = rule.scale or abs(published)
    words = AGREES if abs(difference) <= allowed else DIFFERS
    return Verdict(words, float(allowed), bool(allowed < SHARP * size))


def half_width(published_spread: float | None, found: Finding) -> float:
    """Half the width of Welch's interval of the difference; 0 where neither has a scatter."""
    from scipy.special import stdtrit

    parts = []
    if published_spread is not None and math.isfinite(published_spread):
        parts.append((published_spread**2 / PUBLISHED_STARTS, PUBLISHED_STARTS - 1.0))
    if found.error is not None and found.freedom > 0.0:
        parts.append((found.error**2, found.freedom))
    variance = sum(part for part, _ in parts)
    if variance <= 0.0:
        return 0.0
    freedom = variance**2 / sum(part**2 / free for part, free in parts)
    return float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE)) * math.sqrt(variance)
