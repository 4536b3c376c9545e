"""Hard cases of starts: grains at one place, or overlapping."""

from __future__ import annotations

from typing import Any

from granular.scene.scene import Scene
from validation.exact.problem import lone_scene
from validation.hard_cases.measures import LEDGER, energy_change, ledger
from validation.outcomes import HardCase


def _pair(gap: str, **effects: Any) -> Scene:
    """Two grains of 5 mm at rest, at a distance."""
    return lone_scene(
        "pair",
        0.01,
        {"dipole": {}, **effects},
        arrangement={"positions": [["30 D", "30 D"], [f"{30.0 + float(gap)!r} D", "30 D"]]},
    )


def start_cases() -> tuple[HardCase, ...]:
    """Starts that are none, and one that contact bears."""
    return (
        HardCase(
            "coincident grains", "two grains at one place", lambda: _pair("0.0"), energy_change,
            "relative change of the energy", 1e-6, 0.01, 0.01, errors=("SceneError",),
        ),
        HardCase(
            "nearly coincident grains", "two grains 1e-9 D apart", lambda: _pair("1e-9"),
            energy_change, "relative change of the energy", 1e-6, 0.01, 0.01,
            errors=("SceneError",),
        ),
        HardCase(
            "overlapping start", "two grains 0.8 D apart, without contact", lambda: _pair("0.8"),
            energy_change, "relative change of the energy", 1e-6, 0.01, 0.01,
            errors=("SceneError",),
        ),
        HardCase(
            "overlapping start with contact", "two grains 0.999 D apart, with contact",
            lambda: _pair("0.999", contact={"modulus": 1e8}), ledger, LEDGER, 1e-4, 0.002, 0.01,
        ),
    )  # fmt: skip
