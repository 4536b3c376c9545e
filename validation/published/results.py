"""What was run, as plain data: figures of every start by series, and calculations."""

from __future__ import annotations

import dataclasses
import datetime
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.shared.errors import InputError
from validation.published.calculations import kept
from validation.published.figures import figures_of
from validation.published.finding import Finding
from validation.published.plan import Group
from validation.published.protocols import BEST_FIRST
from validation.published.running import outcomes_of
from validation.published.series import Series

COMMITTED = Path(__file__).parent / "results.json"
"""The results of the full run that come with the package."""

Plain = dict[str, Any]


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
        """Mean and deviation over the starts."""
        count = len(self.values)
        spread = float(self.values.std(ddof=1)) if count > 1 else None
        return Finding(float(self.values.mean()), spread, count, self.protocol, self.step)


@dataclasses.dataclass(frozen=True)
class Results:
    """Everything that was run.

    Attributes
    ----------
    series : mapping
        By ``"name | protocol"``: ``name``, ``protocol``, ``words``, ``step``, ``planned``,
        ``figures`` (lists over the starts by name) and ``errors``.
    calculations : mapping
        Numbers by calculation.
    made : mapping
        Command, date and versions.
    """

    series: Mapping[str, Plain]
    calculations: Mapping[str, Mapping[str, float]]
    made: Mapping[str, str]

    def best(self, *names: str) -> str | None:
        """The best protocol under which all of these series were run, whole if possible."""
        for whole in (True, False):
            for protocol in BEST_FIRST:
                if all(self._ran(f"{name} | {protocol}", whole) for name in names):
                    return protocol
        return None

    def sample(self, name: str, figure: str, protocol: str | None = None) -> Sample | None:
        """A figure of a series, under the best protocol if none is named."""
        chosen = self.best(name) if protocol is None else protocol
        one = self.series.get(f"{name} | {chosen}")
        if one is None:
            return None
        numbers = [x for x in one["figures"].get(figure, []) if x is not None]
        if not numbers:
            return None
        return Sample(np.array(numbers, dtype=float), one["protocol"], str(one["step"]))

    def lists(self, name: str, figure: str, protocol: str | None = None) -> list[np.ndarray]:
        """A figure that is a list of numbers, start by start."""
        chosen = self.best(name) if protocol is None else protocol
        one = self.series.get(f"{name} | {chosen}", {"figures": {}})
        return [np.array(x, dtype=float) for x in one["figures"].get(figure, []) if x]

    def number(self, calculation: str, name: str) -> float | None:
        """A number of a calculation."""
        return self.calculations.get(calculation, {}).get(name)

    def _ran(self, key: str, whole: bool) -> bool:
        one = self.series.get(key)
        if one is None:
            return False
        count = len(one["figures"].get("steps", []))
        return count >= (one["planned"] if whole else 1)

    def to_plain(self) -> Plain:
        """For JSON."""
        return {
            "made": dict(self.made),
            "calculations": {name: dict(one) for name, one in self.calculations.items()},
            "series": dict(self.series),
        }

    @classmethod
    def from_plain(cls, plain: Plain) -> Results:
        """From what `to_plain` made, also by way of JSON."""
        return cls(plain["series"], plain["calculations"], plain["made"])

    def with_others(self, others: Results) -> Results:
        """These results, and series and calculations of others where these have none."""
        return Results(
            {**others.series, **self.series},
            {**others.calculations, **self.calculations},
            self.made or others.made,
        )


EMPTY = Results({}, {}, {})


def collected(groups: Sequence[Group], directory: Path, command: str) -> Results:
    """The results of all series of which something was run.

    Parameters
    ----------
    groups : sequence of Group
    directory : Path
        That the runs were kept in.
    command : str
        That made them.
    """
    found: dict[str, Plain] = {}
    for group in groups:
        for series in group.series:
            plain = _series_results(series, directory)
            if plain is not None:
                found[series.key] = plain
    return Results(found, kept(directory), _made(command))


def read(path: Path) -> Results:
    """Results from a file; empty where there is none.

    Raises
    ------
    InputError
        If the file holds something else.
    """
    try:
        return Results.from_plain(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return EMPTY
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} holds no results ({error}); make it anew") from None


def committed() -> Results:
    """The results that come with the package."""
    return read(COMMITTED)


def _series_results(series: Series, directory: Path) -> Plain | None:
    outcomes = outcomes_of(series, directory)
    if not outcomes:
        return None
    scene = series.scene(series.seeds[0])
    starts = [figures_of(one["figures"], scene) for one in outcomes if one["error"] is None]
    names = [name for name in dict.fromkeys(itertools.chain(*starts)) if _wanted(name, series)]
    return {
        "name": series.name,
        "protocol": series.protocol,
        "words": series.words,
        "step": series.step if isinstance(series.step, str) else f"{series.step:g} s",
        "planned": len(series.seeds),
        "figures": {name: [start[name] for start in starts] for name in names},
        "errors": [one["error"] for one in outcomes if one["error"] is not None],
    }


def _wanted(figure: str, series: Series) -> bool:
    """The courses of force and height are kept where they are shown: the file is to stay small."""
    if figure in ("down", "up"):
        return series.name in ("starts", "direct 368", "second order", "second order, 0.8", "drag")
    return figure not in ("times", "heights_D")


def _made(command: str) -> dict[str, str]:
    from granular.shared.version import versions

    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d")
    return {"command": command, "date": now} | versions()
