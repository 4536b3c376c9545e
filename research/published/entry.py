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

UNEXPLAINED = "Not explained: tried "
"""How the note of a difference begins whose cause is not known."""

CONFIDENCE = 0.95
"""Of the interval of a difference: outside of it means differ."""

PUBLISHED_STARTS = 3
"""Runs behind a published deviation [D, Tables 3.2, 5.2, A.2]."""

SHARP = 0.1
"""A comparison can fail if its interval, from end to end twice this, is below a fifth of the
published value."""


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
    draws : int
        Runs behind a published number without a deviation.
    looks : int
        Values of which the worst is judged: its interval has a confidence of 1 - 0.05/looks.
    """

    limit: str = ""
    comparable: bool = True
    constructed: bool = False
    draws: int = 1
    looks: int = 1


PLAIN = Rule()
"""Means by Welch's interval, single draws by a prediction interval, exact numbers by digits."""


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
        Why ours differs, or cannot be compared; shown where it does. It names a cause that was
        run, or begins with `UNEXPLAINED` and says what was tried.
    reference : float, optional
        What ours is compared with where it is not the value at the key.
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
    reference: float | None = None


class Verdict(NamedTuple):
    """A verdict.

    Attributes
    ----------
    words : str
        One of `VERDICTS`.
    allowed : float or None
        The difference up to which ours would agree; None where that is not asked.
    can_fail : bool
        Whether that is less than `SHARP` of the published value.
    p : float or None
        Probability of so great a difference by chance; None where nothing is random.
    """

    words: str
    allowed: float | None = None
    can_fail: bool = False
    p: float | None = None

    @property
    def agrees(self) -> bool | None:
        """None where no verdict of agreement or difference was given."""
        return {AGREES: True, DIFFERS: False}.get(self.words)


def verdict(
    published: float, published_spread: float | None, result: Finding | None, rule: Rule, digits: int
) -> Verdict:
    """Whether ours differs from the published value.

    The difference of two means is judged by Student's interval of 95 % with the standard errors of
    both (Welch 1947). A published number without a deviation is one draw, with our own scatter: it
    is judged by a prediction interval, whose variance is the scatter's times 1 + 1/n for n starts
    of ours. Half of the last printed digit comes on top. Where ours has no scatter, the printed
    digits decide.

    Parameters
    ----------
    published, published_spread : float
        NaN or None for a spread that is not printed.
    result : Finding or None
    rule : Rule
    digits : int
        Decimals that are printed: half of the last one is rounding.
    """
    if result is None or not math.isfinite(result.value):
        return Verdict(NOT_RUN)
    if rule.constructed:
        return Verdict(BY_CONSTRUCTION)
    if not rule.comparable:
        return Verdict(NOT_COMPARABLE)
    rounding = 0.5 * 10.0**-digits * 1.000001
    error, freedom = error_of_difference(published_spread, result, rule.draws)
    allowed = quantile(freedom, rule.looks) * error + rounding
    difference = result.value - published
    beyond = {"most": difference, "least": -difference}.get(rule.limit, abs(difference))
    words = AGREES if beyond <= allowed else DIFFERS
    p = None if error == 0.0 else _probability((beyond - rounding) / error, freedom, rule.looks)
    return Verdict(words, float(allowed), bool(allowed < SHARP * abs(published)), p)


def error_of_difference(
    published_spread: float | None, result: Finding, draws: int = 1
) -> tuple[float, float]:
    """Standard error of the difference, and its degrees of freedom; 0 where nothing scatters.

    Of a published number without a deviation: of a prediction. Where ours has no scatter of single
    starts but an error, the published one, found in the same way, has the same.
    """
    ours, freedom = result.error or 0.0, result.freedom
    if published_spread is None or not math.isfinite(published_spread):
        own = ours if result.spread is None else result.spread / math.sqrt(draws)
        return (math.hypot(ours, own), freedom) if ours > 0.0 and freedom > 0.0 else (0.0, 0.0)
    parts = [(published_spread**2 / PUBLISHED_STARTS, PUBLISHED_STARTS - 1.0)]
    if ours > 0.0 and freedom > 0.0:
        parts.append((ours**2, freedom))
    variance = sum(part for part, _ in parts)
    if variance <= 0.0:
        return 0.0, 0.0
    return math.sqrt(variance), variance**2 / sum(part**2 / free for part, free in parts)


def quantile(freedom: float, looks: int = 1) -> float:
    """Student's, of an interval of 95 %, or of the worst of some values; 0 without a freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1.0 - 0.5 * (1.0 - CONFIDENCE) / looks)) if freedom > 0.0 else 0.0


def _probability(t: float, freedom: float, looks: int) -> float:
    from scipy.special import stdtr

    return min(1.0, 2.0 * looks * float(stdtr(freedom, -max(t, 0.0))))
