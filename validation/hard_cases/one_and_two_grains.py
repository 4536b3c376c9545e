"""Hard cases of one grain and of two: collisions, starts, drags that end a motion, long steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation.exact import ExactProblem
from validation.exact.problem import BOTTOM_ONLY, few_grains_scene
from validation.hard_cases.hard_case import (
    BROKEN,
    ErrorMeasure,
    HardCase,
    cut_to_few_grains,
    energy_change,
    energy_or_momentum_change,
    greatest_displacement,
    make_distance_from_exact,
    terminal_fall_error,
)

ENERGY = ErrorMeasure("relative change of the energy", energy_change)
ENERGY_AFTERWARDS = ErrorMeasure("relative change of the energy afterwards", energy_change)

# Collisions -------------------------------------------------------------------------------------


def head_on_collision(closest: float) -> ExactProblem:
    """Make the problem of two grains that collide head-on, from 6 D apart.

    Their speed v is that at which the dipoles stop them at a given distance r, by the pair's energy:
    v^2 = (1/r^3 - 1/6^3)/4 in natural units.

    Parameters
    ----------
    closest : float
        Closest distance of the centres [D], above 0 and below 6.

    Returns
    -------
    ExactProblem
        Scene with its exact solution.

    Raises
    ------
    InputError
        If the distance is out of its limits.
    """
    from validation.exact.scattering import APART, scattering_problem

    if not 0.0 < closest < APART:
        raise InputError(f"closest = {closest} D; give a distance above 0 and below {APART:g} D")
    scales = Scales.from_grains(load_scene("single-particle").grains)
    natural = math.sqrt(0.25 / closest**3 - 0.25 / APART**3)
    time = 1.1 * APART / natural * scales.time
    return scattering_problem(natural * scales.velocity, 0.0, time)


def _shot_at_wall(speed: float) -> Scene:
    """Grain shot at the bottom wall from 20 D, and away again; speed [D/tau]."""
    scales = Scales.from_grains(load_scene("single-particle").grains)
    arrangement = {
        "positions": [["30 D", "20 D"]],
        "velocities": [[0.1 * speed * scales.velocity, -speed * scales.velocity]],
    }
    effects = {"gravity": {}, "walls": BOTTOM_ONLY}
    time = 40.0 / speed * scales.time
    return few_grains_scene("shot", time, effects, arrangement=arrangement, cell={"width": "60 D"})


def collision_cases() -> tuple[HardCase, ...]:
    """Hard cases of collisions, whose forces rise steeply within a step."""
    cases = []
    for closest in (0.5, 0.1, 0.02):
        problem = head_on_collision(closest)
        name, time = f"head-on to {closest:g} D", problem.time
        measure = ErrorMeasure(
            "distance from the exact place afterwards [D]", make_distance_from_exact(problem)
        )
        cases += [
            HardCase(title, difficulty, problem.scene.replace, time, time, judged, limit)
            for title, difficulty, judged, limit in (
                (name, "the pair's stiffness grows like r^-5", measure, 1e-2),
                (f"{name}, energy", "the same, judged by its energy", ENERGY_AFTERWARDS, 1e-6),
            )
        ]
    for speed in (1.0, 10.0, 100.0):
        scene = _shot_at_wall(speed)
        length = scene.protocol[0].total_duration(0.0)
        assert length is not None
        cases.append(
            HardCase(
                f"shot at the wall with {speed:g} D/tau",
                "the wall's stiffness grows like w^-4.5",
                scene.replace,
                length,
                length,
                ENERGY_AFTERWARDS,
                1e-5,
            )
        )
    return tuple(cases)


def _unequal_masses(ratio: float) -> Scene:
    """Light grain shot at a heavy one of that many times its mass."""
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
    scene = few_grains_scene("unequal", 2.0 * apart / speed, {"dipole": {}}, arrangement=plan)
    return scene.replace(**{"grains": grains})


def mass_cases() -> tuple[HardCase, ...]:
    """Hard cases of grains of very different masses."""
    measure = ErrorMeasure("relative change of energy or momentum", energy_or_momentum_change)
    return tuple(
        HardCase(
            f"mass ratio {ratio:g}",
            "a light grain bounces off a heavy one",
            partial(_unequal_masses, ratio),
            0.08,
            0.08,
            measure,
            1e-5,
        )
        for ratio in (1e2, 1e4, 1e6)
    )


# Starts -----------------------------------------------------------------------------------------


def _two_grains_at_rest(gap: str, **effects: Any) -> Scene:
    """Two grains of 5 mm at rest, at a distance."""
    return few_grains_scene(
        "pair",
        0.01,
        {"dipole": {}, **effects},
        arrangement={"positions": [["30 D", "30 D"], [f"{30.0 + float(gap)!r} D", "30 D"]]},
    )


def start_cases() -> tuple[HardCase, ...]:
    """Hard cases of coincident and overlapping starts."""
    refused = {
        "coincident grains": ("two grains at one place", "0.0"),
        "nearly coincident grains": ("two grains 1e-9 D apart", "1e-9"),
        "overlapping start": ("two grains 0.8 D apart, without contact", "0.8"),
    }
    return (
        *(
            HardCase(name, what, partial(_two_grains_at_rest, gap), 0.01, 0.01, ENERGY, 1e-6, ("SceneError",))
            for name, (what, gap) in refused.items()
        ),
        HardCase(
            "overlapping start with contact",
            "two grains 0.999 D apart, with contact",
            lambda: _two_grains_at_rest("0.999", contact={"modulus": 1e8}),
            0.002,
            0.01,
        ),
    )


# Drags ------------------------------------------------------------------------------------------


def _overdamped_grain(ratio: float) -> Scene:
    """Drag with gamma h/m of that size, at a step of a millisecond: nothing shortens it here."""
    mass = Scales.from_grains(load_scene("single-particle").grains).mass
    effects = {"gravity": {}, "drag": {"coefficient": ratio * mass / 1e-3}}
    scene = few_grains_scene("overdamped", 1.0, effects, arrangement={"positions": [["30 D", "40 D"]]})
    return scene.replace(**{"output.scalars": 1e-3, "output.frames": 0.1})


def damping_cases() -> tuple[HardCase, ...]:
    """Hard cases of drags from weak to overwhelming, and of beds that hardly swing."""
    fall = ErrorMeasure("relative error of the fall", terminal_fall_error)
    near_one = tuple(
        HardCase(
            f"damping ratio near 1: drag of {drag:g} kg/s",
            "a piston that just swings, or just does not",
            partial(cut_to_few_grains, "damper", **{"effects.drag.coefficient": drag}),
            0.2,
            3.0,
        )
        for drag in (2.0, 2.7, 4.0)
    )
    return near_one + tuple(
        HardCase(
            f"drag with gamma h/m = {ratio:g}",
            "the velocity decays within a step",
            partial(_overdamped_grain, ratio),
            0.1,
            1.0,
            fall,
        )
        for ratio in (1.0, 1e3, 1e6)
    )


# Steps ------------------------------------------------------------------------------------------

LINEAR = 1e-6
"""Swing of the grain near the stability limit, over its height of rest: as wide as the motion is
linear to rounding, and its energy below what the ledger judges."""


def scene_near_stability_limit(
    fraction: float, amplitude: float = LINEAR
) -> tuple[Callable[[], Scene], float]:
    """Make a scene of a swinging grain, with a fraction of the longest step at which Verlet is stable.

    That step is 2/omega, by Hairer, Lubich and Wanner (2003, doi:10.1017/S0962492902000144), section
    5.1; omega is the angular frequency of a grain about the height at which the wall carries it.

    Parameters
    ----------
    fraction : float
        Step over the longest stable one, without unit; above 0.
    amplitude : float
        Height of the start above that of rest, over that of rest, without unit; above -1.

    Returns
    -------
    tuple of function and float
        Function that makes the scene, and the step [s]. The function raises SceneError for a
        ``fraction`` that is not above 0.

    Raises
    ------
    SceneError
        If the amplitude puts the grain into the bottom.
    """
    from validation.exact.bounce import harmonic_period, oscillation_problem

    scene = oscillation_problem(amplitude).scene
    step = fraction * harmonic_period(scene) / math.pi
    return (lambda: scene.replace(**{"output.scalars": step * 8, "output.frames": step * 64})), step


def distance_from_verlet_swing(fraction: float, step: float) -> Callable[[Trajectory], float]:
    """Make the measure of the distance from Verlet's own swing in a linear mode; step [s]."""
    # In a linear mode Verlet's places are A cos(n theta) with cos(theta) = 1 - 2 fraction^2, bounded for ever
    # up to a fraction of one (Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144, sec. 5.1).
    angle = math.acos(1.0 - 2.0 * fraction * fraction)

    def measure(run: Trajectory) -> float:
        heights = run.dataset["position"].values[:, 0, 1]
        count = np.rint(run.dataset["frame_time"].values / step)
        rest = heights[0] / (1.0 + LINEAR)
        swing = heights[0] - rest
        return float(np.abs(heights - rest - swing * np.cos(count * angle)).max() / swing)

    return measure


def _bouncing_grain_with_few_records() -> Scene:
    return load_scene("single-particle").replace(**{"output.scalars": 0.01, "output.frames": 1.0})


def step_cases() -> tuple[HardCase, ...]:
    """Hard cases of long steps, and of many."""
    below, short = scene_near_stability_limit(0.95)
    beyond, long = scene_near_stability_limit(1.05)
    swing = ErrorMeasure(
        "distance from Verlet's exact swing over its width", distance_from_verlet_swing(0.95, short)
    )
    return (
        HardCase(
            "step at 0.95 of the stability limit",
            "a grain 5e-6 D off its place of rest swings for ever as Verlet's mode does; the "
            "energy of a wide swing goes up and down tenfold, by 1/(1 - 0.95^2), which the ledger "
            "stops",
            below,
            384 * short,
            3840 * short,
            swing,
            1e-3,
            dt=short,
        ),
        HardCase(
            "step at 1.05 of the stability limit",
            "the same grain's displacement nearly doubles in each step, until the ledger stops it",
            beyond,
            20.0,
            200.0,
            ErrorMeasure("displacement [D]", greatest_displacement),
            2e-5,
            BROKEN,
            dt=long,
        ),
        HardCase(
            "many steps",
            "1e6 steps of the bouncing grain; 1e8 in the full catalogue",
            _bouncing_grain_with_few_records,
            1.0,
            100.0,
            limit=1e-6,
            dt=1e-6,
        ),
    )
