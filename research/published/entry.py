"""Entry of the comparison: a published number, the computation of our value, and the rule of the verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

from research.published.finding import Finding
from research.published.results import PublishedResults

AGREES = "agrees"
DIFFERS = "differs"
BY_CONSTRUCTION = "by construction"
NOT_COMPARABLE = "not comparable"
NOT_RUN = "not run"
VERDICTS = (AGREES, DIFFERS, BY_CONSTRUCTION, NOT_COMPARABLE, NOT_RUN)

UNEXPLAINED = "Not explained: tried "
"""Beginning of the note on a difference of unknown cause."""

CONFIDENCE = 0.95
"""Confidence of the interval of a difference; means differ outside it."""

PUBLISHED_STARTS = 3
"""Number of runs behind a published deviation [D, Tables 3.2, 5.2, A.2]."""

SHARP = 0.1
"""A comparison can fail if its half interval is below this fraction of the published value, that is, its
interval below a fifth."""


class VerdictRule(NamedTuple):
    """Rule of the verdict on a comparison.

    Attributes
    ----------
    limit : str
        ``""``; ``"most"`` or ``"least"`` if de Paula prints an upper or lower bound.
    comparable : bool
        False if de Paula's figure depends on something that is not printed, or on the machine.
    constructed : bool
        True if ours was made from the published number, so that it cannot differ.
    draws : int
        Number of runs behind a published number without a deviation.
    looks : int
        Number of values of which the worst is judged: its interval has a confidence of 1 - 0.05/looks.
    """

    limit: str = ""
    comparable: bool = True
    constructed: bool = False
    draws: int = 1
    looks: int = 1


PLAIN = VerdictRule()
"""Means by Welch's interval, single draws by a prediction interval, exact numbers by digits."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One published number.

    Attributes
    ----------
    key : str
        Key in ``published.toml``: ``"section.name[index]"``.
    what : str
    measure : callable
        Returns our value from the results; None if its runs are missing.
    unit : str
    rule : Rule
    spread_key : str
        Key of the published standard deviation, if one is printed.
    digits : int
        Number of printed decimals.
    covers : tuple of str
        Further keys with the same content.
    note : str
        Reason why ours differs or cannot be compared; shown in that case. It gives a cause that was run, or
        begins with `UNEXPLAINED` and lists the changes tested.
    reference : float, optional
        Reference value, if not the value at the key.
    """

    key: str
    what: str
    measure: Callable[[PublishedResults], Finding | None]
    unit: str = ""
    rule: VerdictRule = PLAIN
    spread_key: str = ""
    digits: int = 2
    covers: tuple[str, ...] = ()
    note: str = ""
    reference: float | None = None


class Verdict(NamedTuple):
    """A verdict on an entry.

    Attributes
    ----------
    words : str
        One of `VERDICTS`.
    allowed : float or None
        Maximum difference at which ours would agree; None if not applicable.
    can_fail : bool
        True if ``allowed`` is less than `SHARP` of the published value.
    p : float or None
        Probability of such a difference by chance; None if nothing is random.
    """

    words: str
    allowed: float | None = None
    can_fail: bool = False
    p: float | None = None

    @property
    def agrees(self) -> bool | None:
        """True or False for a verdict of agreement or difference; None for other verdicts."""
        return {AGREES: True, DIFFERS: False}.get(self.words)


def judge_difference_from_published(
    published: float, published_spread: float | None, result: Finding | None, rule: VerdictRule, digits: int
) -> Verdict:
    """Return the verdict on the difference of ours from the published value.

    The difference of two means is judged by Student's interval of 95 % with the standard errors of
    both (Welch 1947). A published number without a deviation is one draw, with our scatter: it is judged by a
    prediction interval, whose variance is the variance of our n starts times 1 + 1/n. Half of the last
    printed digit is added. If ours has no scatter, the printed digits decide.

    Parameters
    ----------
    published, published_spread : float
        NaN or None for a spread that is not printed.
    result : Finding or None
    rule : Rule
    digits : int
        Number of printed decimals: half of the last one is rounding.
    """
    if result is None or not math.isfinite(result.value):
        return Verdict(NOT_RUN)
    if rule.constructed:
        return Verdict(BY_CONSTRUCTION)
    if not rule.comparable:
        return Verdict(NOT_COMPARABLE)
    rounding = 0.5 * 10.0**-digits * 1.000001
    error, freedom = standard_error_of_difference_and_freedom(published_spread, result, rule.draws)
    allowed = student_quantile(freedom, rule.looks) * error + rounding
    difference = result.value - published
    beyond = {"most": difference, "least": -difference}.get(rule.limit, abs(difference))
    words = AGREES if beyond <= allowed else DIFFERS
    p = None if error == 0.0 else _two_sided_p_value((beyond - rounding) / error, freedom, rule.looks)
    return Verdict(words, float(allowed), bool(allowed < SHARP * abs(published)), p)


def standard_error_of_difference_and_freedom(
    published_spread: float | None, result: Finding, draws: int = 1
) -> tuple[float, float]:
    """Return the standard error of the difference, and its degrees of freedom; 0 without scatter.

    For a published number without a deviation it is the standard error of a prediction. If ours has an error
    but no scatter of single starts, the published value, found by the same method, is assumed to have the
    same error.
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


def student_quantile(freedom: float, looks: int = 1) -> float:
    """Return Student's quantile of a 95 % interval, or of the worst of some values; 0 without freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1.0 - 0.5 * (1.0 - CONFIDENCE) / looks)) if freedom > 0.0 else 0.0


def _two_sided_p_value(t: float, freedom: float, looks: int) -> float:
    from scipy.special import stdtr

    return min(1.0, 2.0 * looks * float(stdtr(freedom, -max(t, 0.0))))
