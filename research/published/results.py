"""What was run, as plain data: figures of every start by series, and calculations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from research.campaign import Plain, committed_file, read_results
from research.published.finding import Finding
from research.published.protocols import BEST_FIRST

RESIDUAL = 1e-3
"""Residual of the energy over that turned over, above which a series is told of."""


class Sample(NamedTuple):
    """A figure of a series.

    Attributes
    ----------
    values : float array (starts,)
        NaN left out.
    protocol, step : str
    """

    values: np.ndarray
    protocol: str
    step: str

    def finding(self) -> Finding:
        """Mean and deviation over the starts, and the standard error of the mean."""
        count = len(self.values)
        mean = float(self.values.mean())
        if count < 2:
            return Finding(mean, None, count, self.protocol, self.step)
        spread = float(self.values.std(ddof=1))
        error = spread / count**0.5
        return Finding(mean, spread, count, self.protocol, self.step, error, count - 1)


@dataclasses.dataclass(frozen=True)
class Results:
    """Everything that was run, or is to be.

    Attributes
    ----------
    series : mapping
        By ``"name | protocol"``: ``name``, ``protocol``, ``words``, ``step``, ``coarse`` (one of
        de Paula's own schemes), ``seeds`` that are planned; of those that are done ``done``,
        ``figures`` (lists over the starts by name), ``errors``, ``keys`` and ``versions``; the
        ``reference`` run, and whether the series is ``stale``.
    calculations : mapping
        Numbers by calculation.
    made : mapping
        Command, date and versions.
    """

    series: Mapping[str, Plain]
    calculations: Mapping[str, Mapping[str, float]]
    made: Mapping[str, Any]

    def best(self, *names: str) -> str | None:
        """The best protocol that is planned for all of these series; what it gives may lack."""
        for protocol in BEST_FIRST:
            if all(f"{name} | {protocol}" in self.series for name in names):
                return protocol
        return None

    def sample(self, name: str, figure: str, protocol: str | None = None) -> Sample | None:
        """A figure of a series under a protocol, or under the best that is planned.

        None unless all of its starts were run by today's code: nothing stands in for them.
        """
        item = self._integer(name, protocol)
        numbers = [] if item is None else [x for x in item["figures"].get(figure, []) if x is not None]
        if item is None or not numbers:
            return None
        return Sample(np.array(numbers, dtype=float), item["protocol"], str(item["step"]))

    def lists(self, name: str, figure: str, protocol: str | None = None) -> list[np.ndarray]:
        """A figure that is a list of numbers, start by start."""
        item = self._integer(name, protocol)
        result = [] if item is None else item["figures"].get(figure, [])
        return [np.array(x, dtype=float) for x in result if x]

    def number(self, calculation: str, name: str) -> float | None:
        """A number of a calculation."""
        return self.calculations.get(calculation, {}).get(name)

    def _integer(self, name: str, protocol: str | None) -> Plain | None:
        chosen = self.best(name) if protocol is None else protocol
        item = self.series.get(f"{name} | {chosen}")
        return item if item is not None and is_whole(item) else None

    def stopped(self, name: str, protocol: str) -> bool:
        """Whether every start of a series was stopped by an error, its energy for instance."""
        item = self.series.get(f"{name} | {protocol}")
        return item is not None and is_stopped(item)

    def to_plain(self) -> Plain:
        """For JSON."""
        return {
            "made": dict(self.made),
            "calculations": {name: dict(item) for name, item in self.calculations.items()},
            "series": dict(self.series),
        }

    @classmethod
    def from_plain(cls, plain: Plain) -> Results:
        """From what `to_plain` made, also by way of JSON."""
        return cls(plain["series"], plain["calculations"], plain["made"])


EMPTY = Results({}, {}, {})


def is_whole(item: Plain) -> bool:
    """Whether all starts of a series are done, by today's code."""
    return bool(item["done"]) and item["done"] == list(item["seeds"]) and not item.get("stale")


def is_stopped(item: Plain) -> bool:
    """Whether all starts of a series were run by today's code, and each was stopped by an error."""
    return len(item["errors"]) == len(item["seeds"]) and not item["done"] and not item.get("stale")


def counted(results: Results) -> dict[str, int]:
    """How many series are whole, stopped, begun, stale, not run, and miss the energy residual."""
    integer = [item for item in results.series.values() if is_whole(item)]
    stale = [item for item in results.series.values() if item.get("stale")]
    started = [
        item
        for item in results.series.values()
        if item["done"] and not is_whole(item) and not item.get("stale")
    ]
    stopped = [item for item in results.series.values() if is_stopped(item)]
    off = [item for item in integer if not item["coarse"] and worst_residual(item) > RESIDUAL]
    return {
        "planned": len(results.series),
        "whole": len(integer),
        "stopped": len(stopped),
        "begun": len(started),
        "stale": len(stale),
        "not run": len(results.series) - len(integer) - len(stopped) - len(started) - len(stale),
        "residual above 1e-3": len(off),
    }


def worst_residual(item: Plain) -> float:
    """Greatest residual of the energy of the starts of a series, over that turned over."""
    return max((x for x in item["figures"].get("ledger", []) if x is not None), default=0.0)


def read(path: Path) -> Results:
    """Results from a file; empty where there is none.

    Raises
    ------
    InputError
        If the file holds something else.
    """
    return read_results(path, Results.from_plain, EMPTY)


def committed() -> Results:
    """The results that are committed."""
    return read(committed_file("published"))


def sittings_of(former: Sequence[Results]) -> int:
    """How often the full run was begun for earlier results."""
    return max((int(item.made.get("sittings", 0)) for item in former), default=0)
