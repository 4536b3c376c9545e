"""The stored table of prices: what steps err in a few measured scenes, and what they take.

``prices.toml`` is made by ``python -m benchmarks --prices``. A scene is looked up by what damps it
and by its number of grains; an error, by the step over the period of the stiffest mode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from granular.run.summary import effect_names
from granular.scene.scene import Scene
from granular.shared.toml import parse_toml

TABLE = Path(__file__).with_name("prices.toml")

KNOWN = frozenset({"dipole", "walls", "gravity", "drag", "friction"})
"""Effects that the scenes of the table have; it says nothing of others."""

ALIKE = 8.0
"""Ratio of numbers of grains up to which a scene of the table stands for another."""


class Rung(NamedTuple):
    """A method at a step, in a scene of the table.

    Attributes
    ----------
    method, dt : str
    fraction : float
        Automatic step times the highest frequency that it is chosen for.
    frequency : float
        The same product as it was seen in the run.
    seconds : float
        Of a run.
    bounds : mapping of str to float
        What each quantity errs at most.
    clear : list of str
        Quantities whose error was told from the scatter.
    """

    method: str
    dt: str
    fraction: float
    frequency: float
    seconds: float
    bounds: Mapping[str, float]
    clear: list[str]


class Prices(NamedTuple):
    """A scene of the table.

    Attributes
    ----------
    name, kind : str
    grains, starts : int
    floors : mapping of str to float
        How far each quantity scatters over random starts.
    rungs : tuple of Rung
    date : str
        When it was measured.
    """

    name: str
    kind: str
    grains: int
    starts: int
    floors: Mapping[str, float]
    rungs: tuple[Rung, ...]
    date: str

    def floor(self, quantity: str, grains: int) -> float:
        """Scatter for a number of grains: greater for fewer of them, never taken for smaller."""
        return self.floors[quantity] * max(1.0, math.sqrt(self.grains / max(grains, 1)))


def kind_of(scene: Scene) -> str:
    """What damps a scene: friction by either scheme, drag, or nothing."""
    friction = scene.effects.friction
    if friction is not None:
        return "friction" if friction.scheme == "velocity" else "regularised friction"
    return "drag" if scene.effects.drag is not None else "nothing"


@cache
def table() -> tuple[Prices, ...]:
    """The scenes of the stored table."""
    plain = parse_toml(TABLE.read_text(encoding="utf-8"))
    return tuple(_scene(one, plain["made"]["date"]) for one in plain["scenes"])


def _scene(plain: Mapping[str, Any], date: str) -> Prices:
    rungs = tuple(Rung(**one) for one in plain["rungs"])
    return Prices(
        plain["name"], plain["kind"], plain["grains"], plain["starts"], plain["floors"], rungs, date
    )


def prices_of(scene: Scene, quantity: str) -> Prices | None:
    """The scene of the table that is most like another one; None where none is like it."""
    if not KNOWN.issuperset(effect_names(scene)):
        return None

    kind = kind_of(scene)
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)

    def apart(one: Prices) -> float:
        return abs(math.log(one.grains / max(scene.grains.count, 1)))

    def unlike(one: Prices) -> tuple[bool, float]:
        return ("rest height" in one.floors) is not rests, apart(one)

    near = [
        one for one in table()
        if one.kind == kind and quantity in one.floors and apart(one) <= math.log(ALIKE)
    ]  # fmt: skip
    return min(near, key=unlike, default=None)
