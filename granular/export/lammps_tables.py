"""Pair and wall laws as tables that LAMMPS reads, in SI."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from granular.effects import wall_experimental, wall_infinite
from granular.pairs import dipole
from granular.schema.scales import Scales

ROWS = 5000
"""Rows of a table, in geometric steps: LAMMPS draws a cubic spline through them, which is exact to
1e-9 of the force."""

NEAREST_PAIR, NEAREST_WALL = 0.25, 0.1
"""Where the tables begin, in diameters of the smallest species; LAMMPS stops at a grain nearer."""

FARTHEST_WALL = 200.0
"""Where the walls' tables end at the latest [D]; the experimental wall's force there is 5e-9 F*."""

WALL_EXPONENTS = {"experimental": 3.5, "infinite": 3.0}
"""Laws that depend on the distance alone, with the power by which their force falls."""

_PAIR_EXPONENT = 4.0


class LawTable(NamedTuple):
    """A power law from the nearest to the farthest distance.

    Attributes
    ----------
    name : str
    distance, energy, force : float64 (ROWS,)
        [m], [J], [N]
    exponent : float
        The force falls as its inverse power of the distance.
    """

    name: str
    distance: np.ndarray
    energy: np.ndarray
    force: np.ndarray
    exponent: float

    def lines(self, slopes: str) -> Iterator[str]:
        """The section of a table file; ``slopes`` is its keyword for the slopes at both ends."""
        slope = -self.exponent * self.force / self.distance
        yield f"{self.name}\nN {ROWS} {slopes} {slope[0]:.17g} {slope[-1]:.17g}\n\n"
        columns = (self.distance.tolist(), self.energy.tolist(), self.force.tolist())
        for number, row in enumerate(zip(*columns, strict=True), start=1):
            yield "{} {:.17g} {:.17g} {:.17g}\n".format(number, *row)
        yield "\n"


def pair_table(
    name: str, charge: float, nearest: float, farthest: float, scales: Scales
) -> LawTable:
    """Dipole repulsion of two grains, with ``charge`` the product of theirs, up to ``farthest``.

    Distances are in units D.
    """
    r = np.geomspace(nearest, farthest, ROWS)
    energy, force = dipole.ENERGY / r**3, dipole.STRENGTH / r**4
    return _table(name, r, charge * energy, charge * force, _PAIR_EXPONENT, scales)


def wall_table(
    name: str, law: str, charge: float, nearest: float, farthest: float, scales: Scales
) -> LawTable:
    """Repulsion of a grain of that charge from a wall; see `pair_table`."""
    w = np.geomspace(nearest, farthest, ROWS)
    exponent = WALL_EXPONENTS[law]
    strength = {"experimental": wall_experimental, "infinite": wall_infinite}[law].force(1.0)
    force = charge * strength / w**exponent
    return _table(name, w, force * w / (exponent - 1.0), force, exponent, scales)


def _table(
    name: str, distance: np.ndarray, energy: np.ndarray, force: np.ndarray, exponent: float,
    scales: Scales,
) -> LawTable:  # fmt: skip
    return LawTable(
        name, distance * scales.length, energy * scales.energy, force * scales.force, exponent
    )
