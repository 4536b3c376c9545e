"""Hard cases of sizes: light grains among heavy ones."""

from __future__ import annotations

import math
from functools import partial

from granular.scene.scene import Scene
from validation.exact.problem import lone_scene
from validation.hard_cases.measures import FAIR, LEDGER, ledger, momentum_change
from validation.hard_cases.small_beds import few_grains
from validation.outcomes import HardCase


def _unequal(ratio: float) -> Scene:
    """A light grain shot at a heavy one of that many times its mass."""
    small = 5e-3 / math.sqrt(ratio)
    speed, apart = 0.5, 0.02
    grains = {
        "count": 2,
        "species": [
            {"name": "heavy", "diameter": 5e-3, "share": 0.5},
            {"name": "light", "diameter": small, "share": 0.5},
        ],
    }
    plan = {
        "positions": [["30 D", "30 D"], [0.15 + apart, 0.1502]],
        "velocities": [[0.0, 0.0], [-speed, 0.0]],
    }
    scene = lone_scene("unequal", 2.0 * apart / speed, {"dipole": {}}, arrangement=plan)
    return scene.replace(**{"grains": grains})


def _aspect() -> Scene:
    """A bed of grains of which half are a tenth as wide."""
    return few_grains(
        "bed",
        **{
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.5},
                {"name": "small", "diameter": "0.6 mm", "share": 0.5},
            ],
            "effects.drag": None,
        },
    )


def _three() -> Scene:
    """A bed of three kinds, the widest ten times as wide as the narrowest."""
    return few_grains(
        "bed",
        **{
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.4},
                {"name": "middle", "diameter": "1.9 mm", "share": 0.3},
                {"name": "small", "diameter": "0.6 mm", "share": 0.3},
            ],
            "effects.drag": None,
        },
    )


def size_cases() -> tuple[HardCase, ...]:
    """Masses and sizes of very different grains."""
    masses = tuple(
        HardCase(
            f"mass ratio {ratio:g}", "a light grain bounces off a heavy one",
            partial(_unequal, ratio),
            momentum_change, "relative change of energy or momentum", 1e-5, 0.08, 0.08,
        )
        for ratio in (1e2, 1e4, 1e6)
    )  # fmt: skip
    return (
        *masses,
        HardCase(
            "aspect ratio 0.1", "half of the grains are a tenth as wide [D, 4.1]",
            _aspect, ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
        HardCase(
            "three species of ratio 10", "the widest grains are ten times as wide as the narrowest",
            _three, ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
    )  # fmt: skip
