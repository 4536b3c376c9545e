"""Catalogue of hard cases: difficulty, error limit of an accurate run, and errors that may end a run.

Only the following cases may end in an error:

- coincident grains, or grains that overlap initially without contact;
- numbers that are out of range or not finite;
- a piston that starts inside the bed;
- steps beyond the stability limit;
- de Paula's list of pairs, which misses some pairs.

All other cases run accurately with the default settings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from validation import hard_case
from validation.exact_problems import exact_problem
from validation.hard_case import (
    BROKEN,
    ErrorMeasure,
    HardCase,
    make_few_grains_scene_maker,
    make_packaged_scene_maker,
)

PISTONS = (
    HardCase(
        "full-height drop",
        "the piston falls 55 D before it meets the bed",
        make_packaged_scene_maker("damper", hard_case.DROP, {"piston.height": "75 D"}),
        (0.3, 3.0),
        limit=1e-5,
    ),
    HardCase(
        "100 kg piston",
        "a piston of thirteen times the damper's mass falls on the bed",
        make_packaged_scene_maker("damper", hard_case.DROP, {"piston.mass": 100.0}),
        (0.15, 3.0),
    ),
    HardCase(
        "piston inside the bed",
        "de Paula's N = 92 [D, 3.3]",
        make_packaged_scene_maker("bed", hard_case.INSIDE),
        (0.05, 0.2),
        errors=("SceneError",),
    ),
    HardCase(
        "packing above 1",
        "the grains' area exceeds the cell's, without contact",
        make_few_grains_scene_maker("bed", hard_case.SQUEEZE),
        (0.55, 2.0),
    ),
    HardCase(
        "slabs under the bed",
        "the bottom and the piston are finite magnetic slabs",
        make_few_grains_scene_maker("bed", {"effects.walls": hard_case.SLABS}),
    ),
    HardCase(
        "slabs under the bed, with a gap",
        "grains flow out between two slabs",
        make_few_grains_scene_maker("bed", {"effects.walls": hard_case.SLABS_WITH_GAP}),
    ),
    HardCase(
        "slabs with friction and a gap",
        "grains rub on their way out between two slabs",
        make_few_grains_scene_maker("bed", {"effects.walls": hard_case.SLABS_WITH_GAP}, hard_case.RUBBING),
    ),
)


def _collision_cases() -> Iterator[HardCase]:
    """Make the cases of forces that rise steeply within a step."""
    for closest in (0.5, 0.1, 0.02):
        problem = hard_case.head_on_collision(closest)
        name, scene, time = f"head-on to {closest:g} D", problem.scene.replace, problem.time
        distance = ErrorMeasure(
            "distance from the exact position afterwards [D]", hard_case.make_distance_from_exact(problem)
        )
        yield HardCase(name, "the pair's stiffness grows like r^-5", scene, (time, time), distance, 1e-2)
        same = "the same collision, but the error of the energy is measured"
        yield HardCase(f"{name}, energy", same, scene, (time, time), hard_case.ENERGY_AFTERWARDS, 1e-6)
    for speed in (1.0, 10.0, 100.0):
        shot, time = hard_case.make_wall_shot_scene_maker_and_duration(speed)
        name, what = f"shot at the wall with {speed:g} D/tau", "the wall's stiffness grows like w^-4.5"
        yield HardCase(name, what, shot, (time, time), hard_case.ENERGY_AFTERWARDS, 1e-5)


STARTS = (
    *(
        HardCase(
            name,
            what,
            partial(hard_case.two_resting_grains_scene, distance),
            (0.01, 0.01),
            hard_case.ENERGY,
            1e-6,
            ("SceneError",),
        )
        for name, what, distance in (
            ("coincident grains", "two grains at one position", "0.0"),
            ("nearly coincident grains", "two grains 1e-9 D apart", "1e-9"),
            ("overlapping start", "two grains 0.8 D apart, without contact", "0.8"),
        )
    ),
    HardCase(
        "overlapping start with contact",
        "two grains 0.999 D apart, with contact",
        partial(hard_case.two_resting_grains_scene, "0.999", contact={"modulus": 1e8}),
        (0.002, 0.01),
    ),
)


def _friction_cases() -> tuple[HardCase, ...]:
    """Make the cases of dry friction, whose thresholds a step may jump over."""
    problem = exact_problem("sliding")
    times = (problem.time, problem.time)
    distance = ErrorMeasure("distance from exact position [D]", hard_case.make_distance_from_exact(problem))
    long = {"output.scalars": 1e-2, "output.frames": 1e-2}
    strong = {"static": 0.8, "dynamic": 0.8, "torque": "second"}
    return (
        HardCase(
            "friction below the threshold",
            "the weight is 0.7 of the maximum static friction",
            hard_case.loaded_grain_scene,
            (0.5, 5.0),
            hard_case.DISPLACEMENT,
            0.0,
        ),
        HardCase(
            "sliding friction",
            "a grain slides and stops",
            problem.scene.replace,
            times,
            distance,
            1e-2,
            dt=1e-3,
        ),
        HardCase(
            "friction, step 100 times too large",
            "a step is a fifth of the time until the grain stops",
            lambda: problem.scene.replace(**long),
            times,
            distance,
            10.4 * 1e-2**2 / 8.0 / 5e-3,  # a h^2/8: see the problem
            dt=1e-2,
            may_degrade=True,
        ),
        HardCase(
            "bed with dry friction",
            "many grains stick and slip",
            make_few_grains_scene_maker("bed", hard_case.RUBBING),
            (0.2, 2.0),
            limit=1e-2,
        ),
        HardCase(
            "bed with dry friction, step 100 times too large",
            "far beyond the stability limit",
            make_few_grains_scene_maker("bed", hard_case.RUBBING, {"output.scalars": 2e-3}),
            (0.2, 2.0),
            limit=1e-2,
            errors=BROKEN,
            dt=2e-3,
            may_degrade=True,
        ),
        HardCase(
            "slow compression with friction of 0.8",
            "de Paula's protocol with equal static and dynamic friction, and the torque to second order",
            hard_case.make_slow_compression_scene_maker({"effects.friction": strong}),
            (0.5, 30.0),
        ),
        HardCase(
            "1e6 steps of compression under dry friction",
            "rounding errors of the steps accumulate; 1e5 steps in the quick catalogue",
            hard_case.make_slow_compression_scene_maker({"output.scalars": 1e-3, "output.frames": 0.1}),
            (0.2, 2.0),
            dt=2e-6,
        ),
        HardCase(
            "regularised friction with de Paula's list",
            "forces jump when a pair enters the list, and friction chatters",
            make_few_grains_scene_maker("bed", hard_case.DEPAULA_SCHEME),
            (0.2, 2.0),
            limit=1e-2,
            errors=BROKEN,
            may_degrade=True,
        ),
    )


DRAGS = (
    *(
        HardCase(
            f"damping ratio near 1: drag of {drag:g} kg/s",
            "a piston just below or above critical damping",
            make_few_grains_scene_maker("damper", {"effects.drag.coefficient": drag}),
            (0.2, 3.0),
        )
        for drag in (2.0, 2.7, 4.0)
    ),
    *(
        HardCase(
            f"drag with gamma h/m = {ratio:g}",
            "the velocity decays within a step",
            partial(hard_case.overdamped_grain_scene, ratio),
            (0.1, 1.0),
            hard_case.FALL,
        )
        for ratio in (1.0, 1e3, 1e6)
    ),
)

MASSES = tuple(
    HardCase(
        f"mass ratio {ratio:g}",
        "a light grain bounces off a heavy one",
        partial(hard_case.unequal_mass_collision_scene, ratio),
        (0.08, 0.08),
        hard_case.ENERGY_OR_MOMENTUM,
        1e-5,
    )
    for ratio in (1e2, 1e4, 1e6)
)

SIZES = (
    HardCase(
        "aspect ratio 0.1",
        "half of the grains are a tenth as wide [D, 4.1]",
        hard_case.make_mixture_scene_maker(big=("6 mm", 0.5), small=("0.6 mm", 0.5)),
    ),
    HardCase(
        "three species of ratio 10",
        "the widest grains are ten times as wide as the narrowest",
        hard_case.make_mixture_scene_maker(big=("6 mm", 0.4), middle=("1.9 mm", 0.3), small=("0.6 mm", 0.3)),
    ),
)


def _step_length_cases() -> tuple[HardCase, ...]:
    """Make the cases of long steps and of many steps."""
    below, short = hard_case.scene_near_stability_limit(0.95)
    beyond, long = hard_case.scene_near_stability_limit(1.05)
    swing = ErrorMeasure(
        "distance from Verlet's exact oscillation, relative to its amplitude",
        hard_case.make_distance_from_verlet_oscillation(0.95, short),
    )
    return (
        HardCase(
            "step at 0.95 of the stability limit",
            "a grain 5e-6 D from equilibrium oscillates undamped, as in the exact solution of Verlet's "
            "scheme; at a large amplitude the energy ledger would stop the run, because this scheme varies "
            "the energy by the factor 1/(1 - 0.95^2), about ten",
            below,
            (384 * short, 3840 * short),
            swing,
            1e-3,
            dt=short,
        ),
        HardCase(
            "step at 1.05 of the stability limit",
            "the displacement of this grain nearly doubles per step, until the energy ledger stops the run",
            beyond,
            (20.0, 200.0),
            hard_case.DISPLACEMENT,
            2e-5,
            BROKEN,
            dt=long,
        ),
        HardCase(
            "many steps",
            "1e6 steps of the bouncing grain; 1e8 in the full catalogue",
            make_packaged_scene_maker("single-particle", {"output.scalars": 0.01, "output.frames": 1.0}),
            (1.0, 100.0),
            limit=1e-6,
            dt=1e-6,
        ),
    )


COUNTS = tuple(
    HardCase(
        words,
        "sums over grains or pairs are empty",
        make_few_grains_scene_maker("bed", {"grains.count": number}),
    )
    for number, words in enumerate(("no grain", "one grain", "two grains"))
)

PAIR_SUMS = (
    *(
        HardCase(
            f"list of pairs within {radius} D",
            "pairs enter and leave the list as the bed moves [D, 5.2]",
            make_packaged_scene_maker(
                "bed",
                hard_case.PAIR_LIST,
                {"pairs": {"method": "verlet-list", "cut_off": f"{radius} D", "skin": "0.5 D"}},
            ),
            errors=("EnergyError",),
            may_degrade=True,
        )
        for radius in (6.26, 7.26)
    ),
    HardCase(
        "1e5 grains by the mesh",
        "the mesh is 270 times as large as for a small bed",
        make_packaged_scene_maker("bed", hard_case.MANY_GRAINS),
        (2e-4, 2e-3),
    ),
    HardCase(
        "fast grain across a skin in a step",
        "in every step a grain moves farther than the skin of its pair list; it passes grains within their "
        "cut-off radius",
        make_few_grains_scene_maker("bed", hard_case.FAST_GRAIN),
        (0.04, 0.04),
        hard_case.MISSING_FORCE,
        1e-12,
        dt=1e-3,
    ),
    HardCase(
        "far field at longer steps",
        "the far field of a damper is applied as impulses every eighth step (the default)",
        make_few_grains_scene_maker("damper", hard_case.FAR),
    ),
    HardCase(
        "resonance of the far field's impulses",
        "during most of the run, impulses every 128 steps resonate with a fast mode",
        make_few_grains_scene_maker("bed", hard_case.RESONANT),
        (0.2, 2.0),
        dt=2.5e-5,
        may_degrade=True,
    ),
)

HUGE_GRAINS: hard_case.Changes = {
    "grains.species": [{"name": "grain", "diameter": 10.0}],
    "arrangement.positions": [["30 D", "40 D"]],
    "cell.width": "60 D",
    "output.scalars": 0.1,
    "output.frames": 1.0,
}

EXTREMES = tuple(
    HardCase(
        f"extreme: {name}", "extreme but finite", make_packaged_scene_maker("single-particle", changes), times
    )
    for name, changes, times in (
        ("remanence of 1e-4 T", {"grains.remanence": 1e-4}, (0.5, 2.0)),
        ("remanence of 100 T", {"grains.remanence": 100.0}, (0.5, 2.0)),
        ("density of 1 kg/m^3", {"grains.density": 1.0}, (0.5, 2.0)),
        ("density of 1e6 kg/m^3", {"grains.density": 1e6}, (0.5, 2.0)),
        ("gravity of 1e4 m/s^2", {"effects.gravity.acceleration": 1e4}, (0.5, 2.0)),
        ("no gravity", {"effects.gravity.acceleration": 0.0}, (0.5, 2.0)),
        ("grains of 10 m", HUGE_GRAINS, (20.0, 100.0)),  # a fall of 400 m takes nine seconds
    )
)

_UNCOMPUTABLE = ("InputError", "SceneError", "FieldError", "NotFiniteError", "StepCountError")
_NOT_FINITE = ("SceneError", "FieldError", "InputError")

OUT_OF_RANGE = (
    *(
        HardCase(
            f"out of range: {name}",
            "the number of steps is out of range",
            make_packaged_scene_maker("single-particle", changes),
            (0.1, 0.1),
            errors=_UNCOMPUTABLE,
        )
        for name, changes in (
            ("remanence of 1e-30 T", {"grains.remanence": 1e-30}),
            ("remanence of 1e30 T", {"grains.remanence": 1e30}),
            ("records every 1e-29 s", {"output.scalars": 1e-29, "output.frames": 1e-29}),
        )
    ),
    HardCase(
        "out of range: a step of 1e10 s",
        "the step is longer than the run",
        make_packaged_scene_maker("single-particle"),
        (0.1, 0.1),
        errors=("InputError",),
        dt=1e10,
    ),
)

NOT_FINITE = tuple(
    HardCase(
        f"injected {value}: {words}",
        "a number that is not finite",
        make_packaged_scene_maker("single-particle", changes),
        (0.1, 0.1),
        errors=_NOT_FINITE,
        dt=value if words == "the step" else "auto",
    )
    for value in (math.nan, math.inf)
    for words, changes in (
        ("a position", {"arrangement.positions": [[0.15, value]]}),
        ("a velocity", {"arrangement.velocities": [[0.0, value]]}),
        ("the gravity", {"effects.gravity.acceleration": value}),
        ("the drag", {"effects.drag.coefficient": value}),
        ("a duration", {"protocol": [{"kind": "hold", "name": "hold", "duration": value}]}),
        ("the step", {}),
    )
)


def hard_case_catalogue() -> tuple[HardCase, ...]:
    """Return all hard cases.

    Returns
    -------
    tuple of HardCase
        Cases in the order of the report.

    Examples
    --------
    >>> from validation import hard_case_catalogue
    >>> len(hard_case_catalogue()) > 10
    True
    """
    return (
        *PISTONS,
        *_collision_cases(),
        *STARTS,
        *_friction_cases(),
        *DRAGS,
        *MASSES,
        *SIZES,
        *_step_length_cases(),
        *COUNTS,
        *PAIR_SUMS,
        *EXTREMES,
        *OUT_OF_RANGE,
        *NOT_FINITE,
    )
