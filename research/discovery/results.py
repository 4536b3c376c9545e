"""Results as plain data, one row per case."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from research.campaign import Plain, round_floats_in_plain_data
from research.discovery.cases import LIBRARIES, METHODS, NOISES, SEEDS, DiscoveryCase
from research.discovery.peers import FUNCTIONS, PYOPERON, PYOPERON_TUNED, PYSINDY
from research.discovery.systems import DURATION, SAMPLES, SYSTEMS

_DIGITS = 3


class DiscoveryRate(NamedTuple):
    """Numbers of runs of a method that found the law.

    Attributes
    ----------
    planned, run : int
    exact : int
        Runs with the true structure.
    usable : int
        Runs whose law has a free run with an error within the limit `USABLE`.
    found : int
        Runs that are exact or usable.
    crashes : int
    seconds : float or None
        Median time of the processor.
    """

    planned: int
    run: int
    exact: int
    usable: int
    found: int
    crashes: int
    seconds: float | None

    @property
    def found_fraction(self) -> float | None:
        """Fraction of the runs that found the law."""
        return self.found / self.run if self.run else None


@dataclasses.dataclass(frozen=True)
class DiscoveryResults:
    """Rows by case, with command, date and versions."""

    rows: Mapping[DiscoveryCase, Plain]
    made: Mapping[str, Any]

    def rate_of_method(
        self, method: str, library: str, noise: float, systems: Sequence[str] = ()
    ) -> DiscoveryRate:
        """Return the rate of a method with a library at a noise level, over some or all systems."""
        names = [item.name for item in SYSTEMS if not systems or item.name in systems]
        rows = [
            row
            for name in names
            for seed in range(SEEDS)
            if (row := self.rows.get(DiscoveryCase(method, name, library, noise, seed))) is not None
        ]
        return DiscoveryRate(
            planned=len(names) * SEEDS,
            run=len(rows),
            exact=sum(row["exact"] for row in rows),
            usable=sum(row["usable"] for row in rows),
            found=sum(row["exact"] or row["usable"] for row in rows),
            crashes=sum("crash" in row for row in rows),
            seconds=statistics.median(row["seconds"] for row in rows) if rows else None,
        )

    def to_plain(self) -> Plain:
        """Return plain data for JSON."""
        return {
            "made": dict(self.made),
            "setting": {
                "systems": {item.name: {"law": item.law, "library": item.library} for item in SYSTEMS},
                "record": f"{SAMPLES} samples over {DURATION:g} s",
                "PySINDy": PYSINDY,
                "pyoperon": {**PYOPERON, "more where the library is named": FUNCTIONS},
                "pyoperon, tuned": PYOPERON_TUNED,
            },
            "rates": [
                {"method": method, "library": library, "noise": noise}
                | self.rate_of_method(method, library, noise)._asdict()
                for noise in NOISES
                for library in LIBRARIES
                for method in METHODS
            ],
            "rows": [round_floats_in_plain_data(row, _DIGITS) for row in self.rows.values()],
        }

    @classmethod
    def from_plain(cls, plain: Plain) -> DiscoveryResults:
        """Return results from data made by `to_plain`."""
        fields = DiscoveryCase._fields
        rows = {DiscoveryCase(*(row[name] for name in fields)): row for row in plain["rows"]}
        return cls(rows, plain["made"])


EMPTY = DiscoveryResults({}, {})
