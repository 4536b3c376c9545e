"""Results as plain data: the figures of each random start in each series, and results of calculations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from research.campaign import Plain, read_results, results_file_of_campaign
from research.published.finding import Finding
from research.published.protocols import BEST_FIRST

RESIDUAL = 1e-3
"""Energy residual, over the energy turned over, above which a series is reported."""


class FigureSample(NamedTuple):
    """A figure of a series.

    Attributes
    ----------
    values : float array (starts,)
        Values without NaN.
    protocol, step : str
    """

    values: np.ndarray
    protocol: str
    step: str

    def finding(self) -> Finding:
        """Return mean and deviation over the starts, and the standard error of the mean."""
        count = len(self.values)
        mean = float(self.values.mean())
        if count < 2:
            return Finding(mean, None, count, self.protocol, self.step)
        spread = float(self.values.std(ddof=1))
        error = spread / count**0.5
        return Finding(mean, spread, count, self.protocol, self.step, error, count - 1)


@dataclasses.dataclass(frozen=True)
class PublishedResults:
    """Results of all planned series and calculations.

    Attributes
    ----------
    series : mapping
        By ``"name | protocol"``: ``name``, ``protocol``, ``words``, ``step``, ``coarse`` (one of de Paula's
        schemes), planned ``seeds``; for the finished ones ``done``, ``figures`` (lists over the
        starts by name), ``errors``, ``keys`` and ``versions``; the ``reference`` run, and whether the series
        is ``stale``.
    calculations : mapping
        Numbers by calculation.
    made : mapping
        Command, date and versions.
    """

    series: Mapping[str, Plain]
    calculations: Mapping[str, Mapping[str, float]]
    made: Mapping[str, Any]

    def best_common_protocol(self, *names: str) -> str | None:
        """Return the best protocol planned for all of these series; its results may be missing."""
        for protocol in BEST_FIRST:
            if all(f"{name} | {protocol}" in self.series for name in names):
                return protocol
        return None

    def figure_sample(self, name: str, figure: str, protocol: str | None = None) -> FigureSample | None:
        """Return a figure of a series under a protocol, or under the best planned one.

        None unless all of its starts were run with the present code: nothing replaces them.
        """
        item = self._complete_series(name, protocol)
        numbers = [] if item is None else [x for x in item["figures"].get(figure, []) if x is not None]
        if item is None or not numbers:
            return None
        return FigureSample(np.array(numbers, dtype=float), item["protocol"], str(item["step"]))

    def figure_lists_by_start(self, name: str, figure: str, protocol: str | None = None) -> list[np.ndarray]:
        """Return a figure that is a list of numbers, by start."""
        item = self._complete_series(name, protocol)
        result = [] if item is None else item["figures"].get(figure, [])
        return [np.array(x, dtype=float) for x in result if x]

    def calculated_number(self, calculation: str, name: str) -> float | None:
        """Return a number of a calculation."""
        return self.calculations.get(calculation, {}).get(name)

    def _complete_series(self, name: str, protocol: str | None) -> Plain | None:
        chosen = self.best_common_protocol(name) if protocol is None else protocol
        item = self.series.get(f"{name} | {chosen}")
        return item if item is not None and is_complete(item) else None

    def are_all_starts_stopped(self, name: str, protocol: str) -> bool:
        """Return True if every start of a series was stopped by an error, for example of its energy."""
        item = self.series.get(f"{name} | {protocol}")
        return item is not None and is_stopped(item)

    def to_plain(self) -> Plain:
        """Return plain data for JSON."""
        return {
            "made": dict(self.made),
            "calculations": {name: dict(item) for name, item in self.calculations.items()},
            "series": dict(self.series),
        }

    @classmethod
    def from_plain(cls, plain: Plain) -> PublishedResults:
        """Return results from data made by `to_plain`, possibly read from JSON."""
        return cls(plain["series"], plain["calculations"], plain["made"])


EMPTY = PublishedResults({}, {}, {})


def is_complete(item: Plain) -> bool:
    """Return True if all starts of a series are done with the present code."""
    return bool(item["done"]) and item["done"] == list(item["seeds"]) and not item.get("stale")


def is_stopped(item: Plain) -> bool:
    """Return True if all starts of a series were run with the present code and stopped by errors."""
    return len(item["errors"]) == len(item["seeds"]) and not item["done"] and not item.get("stale")


def count_series_by_state(results: PublishedResults) -> dict[str, int]:
    """Return counts of complete, stopped, started, stale, missing series, and of large energy residuals."""
    integer = [item for item in results.series.values() if is_complete(item)]
    stale = [item for item in results.series.values() if item.get("stale")]
    started = [
        item
        for item in results.series.values()
        if item["done"] and not is_complete(item) and not item.get("stale")
    ]
    stopped = [item for item in results.series.values() if is_stopped(item)]
    off = [item for item in integer if not item["coarse"] and maximum_energy_residual(item) > RESIDUAL]
    return {
        "planned": len(results.series),
        "whole": len(integer),
        "stopped": len(stopped),
        "begun": len(started),
        "stale": len(stale),
        "not run": len(results.series) - len(integer) - len(stopped) - len(started) - len(stale),
        "residual above 1e-3": len(off),
    }


def maximum_energy_residual(item: Plain) -> float:
    """Return the maximum energy residual of the starts of a series, over the energy turned over."""
    return max((x for x in item["figures"].get("ledger", []) if x is not None), default=0.0)


def read_results_or_empty(path: Path) -> PublishedResults:
    """Return results from a file, empty if there is no file.

    Raises
    ------
    InputError
        If the file does not hold results.
    """
    return read_results(path, PublishedResults.from_plain, EMPTY)


def read_committed_results() -> PublishedResults:
    """Return the committed results."""
    return read_results_or_empty(results_file_of_campaign("published"))


def full_run_start_count(former: Sequence[PublishedResults]) -> int:
    """Return the number of times the full run was started for earlier results."""
    return max((int(item.made.get("sittings", 0)) for item in former), default=0)
