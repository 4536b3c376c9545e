"""The first screen of the report: what accuracy costs in a scene, and what its effects cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from granular.methods import METHODS
from granular.run.options import is_allowed
from granular.scene.scene import Scene
from granular.shared.errors import GranularError
from validation.choice import STEPS
from validation.cost import LEVELS, Setting, WorkPrecision, finest, varies
from validation.cost.measuring import points, run, starts_of, truths
from validation.parts import Part, Piece, Plain
from validation.quantities import QUANTITIES, MeasuredQuantity

if TYPE_CHECKING:
    from validation.cost.measuring import Truth
    from validation.cost.point import Point

QUICK_SECONDS, FULL_SECONDS = 75.0, 1200.0
"""What the runs of one scene may take [s]."""

MANY_STARTS, FEW_STARTS = 8, 3
"""Starts of a scene whose runs are short, and of one whose are long."""

OTHERS = ("blanes-moan-4",)
"""Methods beside Verlet's, in steps as long as their share of the time allows."""

SHARE = 0.25
"""Of the time, for each other method."""

SINGLE = 0.3
"""Length of a run without a piston [s]: positions mean something over a short time only."""


def glance_part(scenes: Sequence[Scene], *, hard: bool) -> Part:
    """The first screen for these scenes; ``hard`` adds the quick ones of the hard cases."""

    def pieces(full: bool) -> list[Piece]:
        seconds = FULL_SECONDS if full else QUICK_SECONDS
        found = []
        for scene in scenes:
            key = {"scene": scene.digest(), "name": scene.name}
            found += [
                Piece(f"{scene.name}: accuracy", {**key, "seconds": seconds},
                      partial(_accuracy, scene, seconds)),
                Piece(f"{scene.name}: effects", {**key, "what": "effects"},
                      partial(_effects, scene)),
            ]  # fmt: skip
        return [*found, Piece("hard cases", {"what": "hard cases"}, _hard)] if hard else found

    return Part("glance", pieces)


def _effects(scene: Scene) -> Plain:
    from granular.shared.files import finite
    from validation.effect_costs import effect_costs

    return {"effects": finite(effect_costs(scene))}


def _hard() -> Plain:
    from validation.hard_cases import COSTLY, catalogue
    from validation.outcomes import outcome

    light = [one for one in catalogue() if not any(word in one.name for word in COSTLY)]
    return {"outcomes": [outcome(one).to_plain() for one in light]}


def quantities_of(scene: Scene) -> tuple[str, ...]:
    """What a scene is made for, by its piston and its stages."""
    if scene.piston is None:
        return ("energy", "positions")
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)
    swings = scene.output.record is not None
    found = ("rest height",) if rests else ("piston force", "mean distance")
    return (*found, *(("period", "damping ratio") if swings else ()), "energy")


def _accuracy(scene: Scene, seconds: float) -> Plain:
    """Studies of a scene's quantities, and how one fresh start met what they advise."""
    until = SINGLE if scene.piston is None else None
    chosen = [QUANTITIES[name] for name in quantities_of(scene)]
    ladder, scenes, reference = planned(scene, until, seconds)
    given = [None if one.exact is not None else reference for one in chosen]
    truth = truths(scenes, chosen, given, until)
    rows = [points(scenes, chosen, one, truth, until, 1) for one in ladder]
    studies = [
        WorkPrecision(
            scene.name, one.name, "1" if one.relative else one.unit, until,
            tuple(row[k] for row in rows), truth[k].floor, truth[k].told,
        )
        for k, one in enumerate(chosen)
    ]  # fmt: skip
    fresh = _fresh(scenes, chosen, truth, studies, until) if len(scenes) > 1 else []
    return {"studies": [one.to_plain() for one in studies], "fresh": fresh, "starts": len(scenes)}


def planned(
    scene: Scene, until: float | None, seconds: float
) -> tuple[list[Setting], tuple[Scene, ...], Setting]:
    """Settings, starts and a reference whose runs fit into a time.

    Steps are halved from the longest one on, each at twice the time of the one before.
    """
    steps = [dt for dt in STEPS if is_allowed(scene, dt, "stormer-verlet")]
    took = _seconds(scene, Setting("stormer-verlet", steps[0]), until)
    random = varies(scene)
    many = random and MANY_STARTS * took * 2.0**6 <= seconds
    starts = (MANY_STARTS if many else FEW_STARTS) if random else 1
    rungs = math.floor(math.log2(seconds / (starts * took) + 1.0)) - 1
    rungs = min(max(rungs, 2), len(steps) - 1)
    ladder = [Setting("stormer-verlet", dt) for dt in steps[:rungs]]
    for name in OTHERS:
        calls = METHODS[name].force_calls
        room = seconds * SHARE / (starts * took * calls)
        more = min(math.floor(math.log2(room + 1.0)), len(steps)) if room >= 1.0 else 0
        ladder += [
            Setting(name, dt) for dt in steps[:more] if is_allowed(scene, dt, name)
        ]  # fmt: skip
    reference = Setting("stormer-verlet", steps[rungs]) if random else finest(scene)
    return ladder, starts_of(scene, starts - 1), reference


def _seconds(scene: Scene, setting: Setting, until: float | None) -> float:
    """Time of a run, compiled before [s]."""
    import time

    run(scene, setting._replace(dt="auto"), 1e-3 * scene.output.scalars)
    begun = time.perf_counter()
    run(scene, setting, until)
    return time.perf_counter() - begun


def _fresh(
    scenes: Sequence[Scene],
    quantities: Sequence[MeasuredQuantity],
    truth: Sequence[Truth],
    studies: Sequence[WorkPrecision],
    until: float | None,
) -> list[dict[str, Any]]:
    """One more start, run with each setting that a single run is advised of.

    Its value is compared with the mean of the reference over the other starts, or with the exact
    one.
    """
    last = scenes[-1].arrangement.seed
    other = scenes[0].replace(**{"arrangement.seed": last + 1})
    runs: dict[str, Any] = {}
    found = []
    for quantity, one, study in zip(quantities, truth, studies, strict=True):
        if quantity.of_start and quantity.exact is None:
            continue
        for words, level in LEVELS.items():
            best = study.cheapest(level)
            if best is None:
                continue
            label = f"{best.setting.family}, {best.setting.dt}"
            if label not in runs:
                runs[label] = run(other, best.setting, until)
            mean = sum(one.values) / len(one.values)
            error = _error(quantity, runs[label], mean)
            found.append({"scene": other.name, "quantity": quantity.name, "level": words,
                          "setting": label, "error": error, "holds": error <= level})  # fmt: skip
    return found


def _error(quantity: MeasuredQuantity, one: Any, reference: Any) -> float:
    try:
        return quantity.error(quantity.measure(one), reference)
    except GranularError:
        return math.inf


def digit(study: WorkPrecision, best: Point | None) -> str:
    """What a digit more costs: how many times the time."""
    measured = study.digit()
    if measured is not None:
        return f"{measured:.2g} times"
    order = METHODS[best.setting.method].order if best is not None else 2
    return f"{10.0 ** (1.0 / order):.2g} times, by the order"
