"""Spread of a damper's height, frequency and damping ratio over random packings, from a table of beds.

A standard deviation over a few packings is uncertain: from three packings, its 95 % interval spans a factor
of 12. A measured value is therefore pooled with the standard deviation from the table, each weighted by its
degrees of freedom (Smyth 2004, doi:10.2202/1544-6115.1027). The table applies only to the beds in it: in a
bed with a tenth fewer grains, the spread of the damping ratio is 12 times as large (``python -m
research.packings --others``).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.files import parse_toml

if TYPE_CHECKING:
    from granular.scene.scene import Scene

TABLE = Path(__file__).parent / "packing_spread.toml"
"""Table of settled beds, written by ``python -m research.packings``."""
_CONTRADICTION = 1e-3  # probability of such a scatter with the table's spread
_SMALL_LIFT = 0.5  # [D]; at larger amplitudes the damper's frequency depends on the amplitude
_SECTIONS = ("grains", "cell", "piston", "effects", "arrangement")


class ExpectedSpread(NamedTuple):
    """Standard deviation over random packings, and the degrees of freedom with which it is known."""

    deviation: float
    degrees_of_freedom: float

    def pool_with_values(self, values: Sequence[float]) -> ExpectedSpread:
        """Return the pooled standard deviation of this spread and of values from different packings."""
        own = len(values) - 1
        if own < 1:
            return self
        total = own + self.degrees_of_freedom
        variance = (own * float(np.var(values, ddof=1)) + self.degrees_of_freedom * self.deviation**2) / total
        return ExpectedSpread(math.sqrt(variance), total)

    def is_contradicted_by(self, values: Sequence[float]) -> bool:
        """Return True if values from several packings scatter significantly more than expected (F test)."""
        from scipy.stats import f

        own = len(values) - 1
        if own < 1 or not self.degrees_of_freedom:
            return False
        limit = float(f.ppf(1.0 - _CONTRADICTION, own, self.degrees_of_freedom))
        return float(np.var(values, ddof=1)) > limit * self.deviation**2

    def half_width(self, packings: int = 1) -> float:
        """Return the half-width of a further packing's 95 % prediction interval about a mean of packings."""
        from scipy.stats import t

        return float(t.ppf(0.975, self.degrees_of_freedom)) * self.deviation * math.sqrt(1.0 + 1.0 / packings)


NO_TABLE = ExpectedSpread(0.0, 0.0)
"""Expected spread of a bed that is not in the table. With zero degrees of freedom it has no weight, and only
measured packings count (Student's t, doi:10.1093/biomet/6.1.1)."""


class PackingSpread(NamedTuple):
    """Expected relative spread over packings of equilibrium height, natural frequency and damping ratio."""

    height: ExpectedSpread
    frequency: ExpectedSpread
    damping_ratio: ExpectedSpread
    packings: int  # number of packings of the tabulated bed


def expected_packing_spread(scene: Scene) -> PackingSpread | None:
    """Return the spread of small oscillations over random packings of a scene's bed, from the table.

    Return None if the bed is not in the table, or if the scene does not record the free decay after a small
    lift from rest.
    """
    from granular.scene.named_scenes import load_scene

    if not _records_decay_after_small_lift(scene):
        return None
    for name, figures in read_tabulated_packings().items():
        if _content_determining_settled_bed(scene) == _content_determining_settled_bed(load_scene(name)):
            return relative_spread_over_packings(figures)
    return None


def _records_decay_after_small_lift(scene: Scene) -> bool:
    from granular.protocol.stages import Free, Hold, Lift

    later, limit = scene.protocol[1:], _SMALL_LIFT * scene.grains.species[0].diameter
    if scene.output.record not in [stage.name for stage in later if isinstance(stage, Free)]:
        return False
    return all(
        isinstance(stage, Free | Hold) or (isinstance(stage, Lift) and abs(stage.by) <= limit)
        for stage in later
    )


def _content_determining_settled_bed(scene: Scene) -> tuple[object, ...]:
    """Return the parts of a scene that determine how its bed settles, without the random seed."""
    plain = scene.replace(**{"arrangement.seed": 1}).to_plain()
    return (*(plain[name] for name in _SECTIONS), plain["protocol"][:1])


def relative_spread_over_packings(figures: Float[np.ndarray, "p 3"]) -> PackingSpread:
    """Return relative standard deviations of height, frequency and damping ratio over packings."""
    packings = len(figures)
    deviations = np.std(figures, axis=0, ddof=1) / np.mean(figures, axis=0)
    height, frequency, damping_ratio = (ExpectedSpread(float(size), packings - 1.0) for size in deviations)
    return PackingSpread(height, frequency, damping_ratio, packings)


@functools.cache
def read_tabulated_packings() -> dict[str, Float[np.ndarray, "p 3"]]:
    """Read height [m], frequency [Hz] and damping ratio of each packing, by name of the packaged scene."""
    table = parse_toml(TABLE.read_text(encoding="utf-8"))
    return {name: np.array(rows) for name, rows in table.items()}
