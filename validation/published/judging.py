"""Entries, judged: the rows of the report and of the results file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from validation.published.catalogue import entries
from validation.published.entry import DIFFERS, NOT_COMPARABLE, NOT_RUN, Entry, Verdict
from validation.published.entry import verdict as verdict_of
from validation.published.finding import Finding
from validation.published.results import Results
from validation.published.values import published_value


class Judged(NamedTuple):
    """An entry with the published value, ours and the verdict."""

    entry: Entry
    published: float
    published_spread: float | None
    found: Finding | None
    verdict: Verdict

    @property
    def source(self) -> str:
        """The section's table or figure."""
        return str(published_value(f"{self.entry.key.split('.')[0]}.source"))

    @property
    def note(self) -> str:
        """Why ours differs or cannot be compared."""
        return self.entry.note if self.verdict.words in (DIFFERS, NOT_COMPARABLE) else ""

    def to_plain(self) -> dict[str, Any]:
        """For JSON."""
        found = self.found
        return {
            "key": self.entry.key,
            "what": self.entry.what,
            "source": self.source,
            "unit": self.entry.unit,
            "published": self.published,
            "published_spread": self.published_spread,
            "ours": None if found is None else _short(found.value),
            "spread": None if found is None or found.spread is None else _short(found.spread),
            "starts": 0 if found is None else found.starts,
            "protocol": None if found is None else found.protocol,
            "step": None if found is None else found.step,
            "verdict": self.verdict.words,
            "agrees": self.verdict.agrees,
            "note": self.note,
        }


def judged(results: Results) -> list[Judged]:
    """All entries."""
    return [_judge(entry, results) for entry in entries()]


def counts(rows: Sequence[Judged]) -> dict[str, int]:
    """How many entries agree, differ, cannot be compared, and were not run."""
    kinds = Counter(_kind(row.verdict) for row in rows)
    return {name: kinds[name] for name in ("agree", "differ", "not comparable", "not run yet")}


def _kind(one: Verdict) -> str:
    if one.words == NOT_RUN:
        return "not run yet"
    if one.agrees is None:
        return "not comparable"
    return "agree" if one.agrees else "differ"


def _judge(entry: Entry, results: Results) -> Judged:
    published = float(published_value(entry.key))
    spread = float(published_value(entry.spread_key)) if entry.spread_key else None
    spread = None if spread is None or math.isnan(spread) else spread
    found = entry.measure(results)
    said = verdict_of(published, spread, found, entry.rule, entry.digits)
    return Judged(entry, published, spread, found, said)


def _short(value: float) -> float:
    return float(f"{value:.6g}")
