"""Hard cases of numbers: none, few, extreme, and those that are no numbers."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.hard_cases.hard_case import HardCase, cut_to_few_grains


def _bed_with_count(number: int) -> Scene:
    return cut_to_few_grains("bed", **{"grains.count": number})


def _bed_with_value(key: str, value: float) -> Scene:
    wrong: dict[str, Any] = {
        "arrangement.positions": [[0.15, value]],
        "arrangement.velocities": [[0.0, value]],
        "protocol": [{"kind": "hold", "name": "hold", "duration": value}],
    }
    return _bouncing_grain(**{key: wrong.get(key, value)})


def _bouncing_grain(**changes: Any) -> Scene:
    return load_scene("single-particle").replace(**changes)


def small_count_cases() -> tuple[HardCase, ...]:
    """Hard cases of beds of no grain, one and two."""
    return tuple(
        HardCase(words, "sums over grains or pairs are empty", partial(_bed_with_count, number))
        for number, words in ((0, "no grain"), (1, "one grain"), (2, "two grains"))
    )


def extreme_cases() -> tuple[HardCase, ...]:
    """Hard cases of numbers that are extreme but finite."""
    cases: dict[str, dict[str, Any]] = {
        "remanence of 1e-4 T": {"grains.remanence": 1e-4},
        "remanence of 100 T": {"grains.remanence": 100.0},
        "density of 1 kg/m^3": {"grains.density": 1.0},
        "density of 1e6 kg/m^3": {"grains.density": 1e6},
        "gravity of 1e4 m/s^2": {"effects.gravity.acceleration": 1e4},
        "no gravity": {"effects.gravity.acceleration": 0.0},
        "grains of 10 m": {
            "grains.species": [{"name": "grain", "diameter": 10.0}],
            "arrangement.positions": [["30 D", "40 D"]],
            "cell.width": "60 D",
            "output.scalars": 0.1,
            "output.frames": 1.0,
        },
    }
    # A fall of 400 m takes nine seconds.
    times = {"grains of 10 m": (20.0, 100.0)}
    return tuple(
        HardCase(
            f"extreme: {name}",
            "extreme but finite",
            partial(_bouncing_grain, **changes),
            *times.get(name, (0.5, 2.0)),
        )
        for name, changes in cases.items()
    )


def uncomputable_cases() -> tuple[HardCase, ...]:
    """Hard cases of numbers that a scene admits and nothing can be computed with."""
    errors = ("InputError", "SceneError", "FieldError", "NotFiniteError", "StepCountError")
    cases: dict[str, dict[str, Any]] = {
        "remanence of 1e-30 T": {"grains.remanence": 1e-30},
        "remanence of 1e30 T": {"grains.remanence": 1e30},
        "records every 1e-29 s": {"output.scalars": 1e-29, "output.frames": 1e-29},
    }
    return (
        *(
            HardCase(
                f"unheard of: {name}",
                "its steps cannot be counted",
                partial(_bouncing_grain, **changes),
                0.1,
                0.1,
                errors=errors,
            )
            for name, changes in cases.items()
        ),
        HardCase(
            "unheard of: a step of 1e10 s",
            "it is longer than the run",
            _bouncing_grain,
            0.1,
            0.1,
            errors=("InputError",),
            dt=1e10,
        ),
    )


def non_finite_cases() -> tuple[HardCase, ...]:
    """Hard cases of NaN and infinity in a scene's every kind of number, and as the step."""
    keys = {
        "a position": "arrangement.positions",
        "a velocity": "arrangement.velocities",
        "the gravity": "effects.gravity.acceleration",
        "the drag": "effects.drag.coefficient",
        "a duration": "protocol",
    }
    case = partial(
        HardCase,
        difficulty="a number that is not finite",
        quick_time=0.1,
        full_time=0.1,
        errors=("SceneError", "FieldError", "InputError"),
    )
    cases = []
    for value in (math.nan, math.inf):
        cases += [
            case(name=f"injected {value}: {words}", scene=partial(_bed_with_value, key, value))
            for words, key in keys.items()
        ]
        cases.append(case(name=f"injected {value}: the step", scene=_bouncing_grain, dt=value))
    return tuple(cases)
