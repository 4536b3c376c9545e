"""Heated, shaken, compressed and settled beds whose effective temperatures are compared."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene

COUNT = 184
"""Number of grains of each bed; width and heights of the packaged bed are scaled by sqrt(184/368)."""

STARTS = 2
"""Number of seeds for each kind of driving and its parameters."""

GROUPS = ("bath", "shaken", "compressed", "settled")
"""Kinds of driving. A curve fitted to three of them must predict the fourth."""

PACKINGS = (1.0, 1.25, 1.5)
"""Heights of the piston, divided by the height of the packaged bed at full compression."""

FRAMES, MOVING = 0.037, 100
"""Interval between frames [s], not an integer number of periods of any shaking; and number of frames of a
compression, whose interval may be shorter."""

SETTLE, MEASURE, STEP, AFTER = 4.0, 6.0, 0.2, 1.0
"""Durations [s] of settling, measurement, the piston's small step, and the time after it."""

LOWERED = 0.02
"""Fraction of its height by which the piston steps down, to measure the response of the force."""

_UNIT = 5.68e-4
"""Energy of a pair at the mean spacing of the densest of these beds [J]: imposed temperatures are fractions
of it. Measured temperatures are compared with the measured pair energy."""


class DisorderBed(NamedTuple):
    """A bed with its kind of driving and parameters.

    Attributes
    ----------
    group : str
        Of `GROUPS`.
    packing : float
        Height of the piston over the height of the packaged bed.
    first, second : float
        Temperature over the energy of a pair and rate [1/s] of a bath; frequency [Hz] and amplitude
        [mm] of a shaking; speed of the piston [mm/s] and drag coefficient [kg/s] of a compression; unused for
        a settled bed.
    seed : int
        Seed of the arrangement, and of the bath.
    """

    group: str
    packing: float
    first: float
    second: float
    seed: int

    @property
    def key(self) -> str:
        """Name of the bed in a file of results."""
        return f"{self.group}-{self.packing:g}-{self.first:g}-{self.second:g}-{self.seed}"

    @property
    def height(self) -> float:
        """Height of the piston during the measurement [D]."""
        return 20.0 * math.sqrt(COUNT / 368) * self.packing


_SHAKEN = (
    (20.0, 1.0),
    (20.0, 1.6),
    (20.0, 2.4),
    (40.0, 0.4),
    (40.0, 0.8),
    (40.0, 1.4),
    (60.0, 0.4),
    (60.0, 0.7),
    (60.0, 1.2),
    (100.0, 0.2),
    (100.0, 0.35),
    (100.0, 0.6),
)
_BATHS = (0.01, 0.03, 0.06, 0.09, 0.12, 0.16, 0.22, 0.35)
_SPEEDS = (5.0, 20.0, 80.0)


def all_beds() -> list[DisorderBed]:
    """Return all beds, each with a different random start."""
    beds: list[tuple[str, float, float, float]] = []
    for k, fraction in enumerate(_BATHS):
        beds.append(("bath", PACKINGS[k % 3], fraction, 5.0))
    beds += [("bath", PACKINGS[(k + 1) % 3], fraction, 5.0) for k, fraction in enumerate(_BATHS[1::2])]
    beds += [("shaken", PACKINGS[k % 2], *item) for k, item in enumerate(_SHAKEN)]
    beds += [
        ("compressed", packing, speed, drag)
        for packing, drag in zip(PACKINGS, (0.02, 0.1, 0.02), strict=True)
        for speed in _SPEEDS
    ]
    beds += [("settled", PACKINGS[k % 3], 0.0, 0.0) for k in range(9)]
    return [DisorderBed(*item, seed) for seed, item in enumerate(STARTS * beds, 1)]


def bath_temperature(bed: DisorderBed) -> float:
    """Return the temperature of a bath [J]."""
    return bed.first * _UNIT / bed.packing**1.5


def scene_of_bed(bed: DisorderBed) -> Scene:
    """Return the scene of a bed, with stages ``settle``, ``measure``, ``step`` and ``after``."""
    begun = bed.height * (1.4 if bed.group == "compressed" else 1.0)
    changes: dict[str, Any] = {
        "name": bed.key,
        "grains.count": COUNT,
        "cell.width": _length_text_in_diameters(60.0 * math.sqrt(COUNT / 368)),
        "piston.height": _length_text_in_diameters(begun),
        "arrangement.height": _length_text_in_diameters(begun - 1.0),
        "arrangement.seed": bed.seed,
        "output.frames": _frame_interval(bed),
        "output.scalars": 0.001,
        "protocol": _protocol_stages(bed),
    }
    return load_scene("bed").replace(**changes, **_driving_changes(bed))


def _frame_interval(bed: DisorderBed) -> float:
    if bed.group != "compressed":
        return FRAMES
    way = 0.2 * bed.height * load_scene("bed").grains.species[0].diameter
    return max(0.001, round(way / (1e-3 * bed.first) / MOVING, 3))


def _driving_changes(bed: DisorderBed) -> dict[str, Any]:
    if bed.group == "bath":
        bath = {"temperature": bath_temperature(bed), "rate": bed.second, "seed": bed.seed}
        return {"effects.drag": None, "effects.bath": bath}
    if bed.group == "shaken":
        shaking = {"frequency": bed.first, "amplitude": 1e-3 * bed.second}
        return {"effects.drag.coefficient": 0.005, "effects.shaking": shaking}
    if bed.group == "compressed":
        return {"effects.drag.coefficient": bed.second}
    return {"effects.drag": None, "effects.friction": True}


def _protocol_stages(bed: DisorderBed) -> list[dict[str, Any]]:
    if bed.group == "compressed":
        # Measured over the last fifth of the height, while the piston moves.
        way = {"kind": "move", "speed": 1e-3 * bed.first}
        return [
            {"name": "settle", "kind": "hold", "duration": SETTLE},
            {**way, "name": "approach", "to": _length_text_in_diameters(1.1 * bed.height)},
            {**way, "name": "measure", "to": _length_text_in_diameters(0.9 * bed.height)},
        ]
    return [
        {"name": "settle", "kind": "hold", "duration": SETTLE},
        {"name": "measure", "kind": "hold", "duration": MEASURE},
        {
            "name": "step",
            "kind": "move",
            "to": _length_text_in_diameters(bed.height * (1.0 - LOWERED)),
            "duration": STEP,
        },
        {"name": "after", "kind": "hold", "duration": AFTER + MEASURE},
    ]


def _length_text_in_diameters(number: float) -> str:
    return f"{number!r} D"
