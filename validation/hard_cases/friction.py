"""Hard cases of dry friction: grains that stick, slide and stop."""

from __future__ import annotations

from typing import Any

from granular.scene.published_beds import mono_bed
from granular.scene.scene import Scene
from validation.exact import closed_forms
from validation.exact.problem import few_grains_scene
from validation.hard_cases.hard_case import (
    BROKEN,
    ErrorMeasure,
    HardCase,
    cut_to_few_grains,
    greatest_displacement,
    make_distance_from_exact,
)


def _loaded_grain(load: float) -> Scene:
    """Grain under its weight, pressed on the plates; load [N]."""
    arrangement = {"positions": [["30 D", "30 D"]]}
    return few_grains_scene(
        "loaded", 0.5, {"gravity": {}, "friction": {"load": load}}, arrangement=arrangement
    )


def _slow_compression(**changes: Any) -> Scene:
    """De Paula's slow compression of a bed of 23 grains, at its first speed [D, 2.3]."""
    return mono_bed(23, speed=8.33e-3, relaxation=0.1).replace(**changes)


def _pair_list_scheme() -> Scene:
    """De Paula's scheme: regularised friction, and its list of pairs."""
    return cut_to_few_grains(
        "bed",
        **{
            "effects.drag": None,
            "effects.friction": {"scheme": "regularised"},
            "pairs": {"method": "verlet-list", "cut_off": "5 D", "skin": "1 D"},
        },
    )


def friction_cases() -> tuple[HardCase, ...]:
    """Hard cases of dry friction, whose thresholds a step may jump over."""
    problem = closed_forms.sliding_problem()
    distance = ErrorMeasure("distance from the exact place [D]", make_distance_from_exact(problem))
    limit = 10.4 * 1e-2**2 / 8.0 / 5e-3  # a h^2/8: see the problem
    rubbing: dict[str, Any] = {"effects.drag": None, "effects.friction": {}}
    strong = {"static": 0.8, "dynamic": 0.8, "torque": "second"}
    return (
        HardCase(
            "friction below the threshold",
            "the weight is 0.7 of what static friction holds",
            lambda: _loaded_grain(0.01),
            0.5,
            5.0,
            ErrorMeasure("displacement [D]", greatest_displacement),
            0.0,
        ),
        HardCase(
            "sliding friction",
            "a grain slides and stops",
            problem.scene.replace,
            problem.time,
            problem.time,
            distance,
            1e-2,
            dt=1e-3,
        ),
        HardCase(
            "friction, step 100 times too large",
            "a step of a fifth of the time to the stop",
            lambda: problem.scene.replace(**{"output.scalars": 1e-2, "output.frames": 1e-2}),
            problem.time,
            problem.time,
            distance,
            limit,
            dt=1e-2,
            may_degrade=True,
        ),
        HardCase(
            "bed with dry friction",
            "many grains stick and slip",
            lambda: cut_to_few_grains("bed", **rubbing),
            0.2,
            2.0,
            limit=1e-2,
        ),
        HardCase(
            "bed with dry friction, step 100 times too large",
            "far beyond the stability limit",
            lambda: cut_to_few_grains("bed", **rubbing, **{"output.scalars": 2e-3}),
            0.2,
            2.0,
            limit=1e-2,
            errors=BROKEN,
            dt=2e-3,
            may_degrade=True,
        ),
        HardCase(
            "slow compression with friction of 0.8",
            "static and dynamic friction alike, the torque to second order, de Paula's protocol",
            lambda: _slow_compression(**{"effects.friction": strong}),
            0.5,
            30.0,
        ),
        HardCase(
            "1e6 steps of compression under dry friction",
            "what a step loses by rounding adds up; 1e5 steps in the quick catalogue",
            lambda: _slow_compression(**{"output.scalars": 1e-3, "output.frames": 0.1}),
            0.2,
            2.0,
            dt=2e-6,
        ),
        HardCase(
            "regularised friction with de Paula's list",
            "forces jump where a list takes pairs in, and friction chatters",
            _pair_list_scheme,
            0.2,
            2.0,
            limit=1e-2,
            errors=BROKEN,
            may_degrade=True,
        ),
    )
