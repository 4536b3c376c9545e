"""Verdicts on all entries, as rows of the report and of the results file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from research.campaign import Plain
from research.published.catalogue import all_entries
from research.published.entry import (
    AGREES,
    CONFIDENCE,
    DIFFERS,
    NOT_COMPARABLE,
    UNEXPLAINED,
    VERDICTS,
    Entry,
    Verdict,
)
from research.published.entry import judge_difference_from_published as verdict_of
from research.published.finding import Finding
from research.published.protocols import PUBLISHED
from research.published.results import PublishedResults
from validation.measured_quantities import published_value


class JudgedEntry(NamedTuple):
    """An entry with the published value, our value and the verdict."""

    entry: Entry
    published: float
    published_spread: float | None
    found: Finding | None
    verdict: Verdict

    @property
    def source(self) -> str:
        """Table or figure of the section."""
        return str(published_value(f"{self.entry.key.split('.')[0]}.source"))

    @property
    def note(self) -> str:
        """Reason why ours differs or cannot be compared."""
        return self.entry.note if self.verdict.words in (DIFFERS, NOT_COMPARABLE) else ""

    @property
    def is_by_source_protocol(self) -> bool:
        """True if ours is based on runs of de Paula's protocol."""
        return self.found is not None and self.found.protocol == PUBLISHED.name

    def to_plain(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        found = self.found
        half = None if found is None else found.half_width()
        return {
            "key": self.entry.key,
            "what": self.entry.what,
            "source": self.source,
            "unit": self.entry.unit,
            "published": self.published,
            "published_spread": self.published_spread,
            "ours": None if found is None else _round_to_six_digits(found.value),
            "spread": None if found is None or found.spread is None else _round_to_six_digits(found.spread),
            "half_width": None if half is None else _round_to_six_digits(half),
            "starts": 0 if found is None else found.starts,
            "protocol": None if found is None else found.protocol,
            "step": None if found is None else found.step,
            "verdict": self.verdict.words,
            "allowed": None if self.verdict.allowed is None else _round_to_six_digits(self.verdict.allowed),
            "can_fail": self.verdict.can_fail,
            "p": None if self.verdict.p is None else _round_to_six_digits(self.verdict.p),
            "note": self.note,
        }


def judge_all_entries(results: PublishedResults) -> list[JudgedEntry]:
    """Return all judged entries; differences are limited by a false discovery rate over all entries.

    Some of many comparisons differ by chance. By Benjamini and Hochberg (1995) at most 5 % of the remaining
    differences are expected to be by chance.
    """
    from scipy.stats import false_discovery_control

    rows = [judge_entry(entry, results) for entry in all_entries()]
    places = [k for k, row in enumerate(rows) if row.verdict.p is not None]
    if not places:
        return rows
    adjusted = false_discovery_control([rows[k].verdict.p for k in places])
    for k, p in zip(places, adjusted, strict=True):
        judgement = rows[k].verdict
        words = AGREES if p > 1.0 - CONFIDENCE else judgement.words
        rows[k] = rows[k]._replace(verdict=judgement._replace(words=words))
    return rows


def count_entries_by_verdict(rows: Sequence[JudgedEntry]) -> dict[str, int]:
    """Return the number of entries with each verdict."""
    kinds = Counter(row.verdict.words for row in rows)
    return {name: kinds[name] for name in VERDICTS}


def count_strong_comparisons(rows: Sequence[JudgedEntry]) -> dict[str, int]:
    """Return the number of entries that could have failed, and the number by de Paula's protocol."""
    differ = [row for row in rows if row.verdict.words == DIFFERS]
    unexplained = sum(row.note.startswith(UNEXPLAINED) for row in differ)
    agree = [row for row in rows if row.verdict.words == AGREES]
    return {
        "differ for a cause that was simulated": len(differ) - unexplained,
        "differ without an explanation": unexplained,
        "agree and could have failed": sum(row.verdict.can_fail for row in agree),
        "are based on de Paula's protocol": sum(row.is_by_source_protocol for row in rows),
    }


def verdict_counts_text(rows: Sequence[JudgedEntry]) -> str:
    """Return both counts as text."""
    numbers = {**count_entries_by_verdict(rows), **count_strong_comparisons(rows)}
    return ", ".join(f"{number} {_PLURALS.get(name, name)}" for name, number in numbers.items())


_PLURALS = {AGREES: "agree", DIFFERS: "differ"}


def judge_entry(entry: Entry, results: PublishedResults) -> JudgedEntry:
    """Judge one entry."""
    published = float(published_value(entry.key) if entry.reference is None else entry.reference)
    spread = float(published_value(entry.spread_key)) if entry.spread_key else None
    spread = None if spread is None or math.isnan(spread) else spread
    found = entry.measure(results)
    judgement = verdict_of(published, spread, found, entry.rule, entry.digits)
    return JudgedEntry(entry, published, spread, found, judgement)


class _SeriesRecordingReads(dict[str, Plain]):
    """Mapping of series that records the keys that were read."""

    def __init__(self, series: Mapping[str, Plain]) -> None:
        super().__init__(series)
        self.asked: list[str] = []

    def get(self, key: str, default: Any = None) -> Any:
        if key in self and key not in self.asked:
            self.asked.append(key)
        return super().get(key, default)


def keys_of_series_behind_entry(entry: Entry, results: PublishedResults) -> list[str]:
    """Return the keys of the series behind an entry."""
    watched = _SeriesRecordingReads(results.series)
    entry.measure(PublishedResults(watched, results.calculations, results.made))
    return watched.asked


def _round_to_six_digits(value: float) -> float:
    return float(f"{value:.6g}")
