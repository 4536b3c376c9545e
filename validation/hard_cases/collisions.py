"""Hard cases of collisions: pairs head-on, and grains shot at a wall."""

from __future__ import annotations

import math
from functools import partial

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.scales import Scales
from validation.exact import Problem
from validation.exact.problem import BOTTOM_ONLY, lone_scene
from validation.hard_cases.measures import distance_to, energy_change
from validation.outcomes import HardCase


def _as_it_is(scene: Scene) -> Scene:
    return scene


def head_on(closest: float) -> Problem:
    """Two grains head-on at the speed that brings them to a distance [D], from 6 D apart."""
    from validation.exact.scattering import APART, problem

    scales = Scales.of(load_scene("single-particle").grains)
    natural = math.sqrt(0.25 / closest**3 - 0.25 / APART**3)
    time = 1.1 * APART / natural * scales.time
    return problem(natural * scales.velocity, 0.0, time)


def _shot(speed: float) -> Scene:
    """A grain shot at the bottom wall from 20 D [D/tau], and away again."""
    scales = Scales.of(load_scene("single-particle").grains)
    arrangement = {
        "positions": [["30 D", "20 D"]],
        "velocities": [[0.1 * speed * scales.velocity, -speed * scales.velocity]],
    }
    time = 20.0 / speed * scales.time
    return lone_scene(
        "shot",
        2.0 * time,
        {"gravity": {}, "walls": BOTTOM_ONLY},
        arrangement=arrangement,
        cell={"width": "60 D"},
    )


def collision_cases() -> tuple[HardCase, ...]:
    """Forces that rise steeply within a step."""
    found = []
    for closest in (0.5, 0.1, 0.02):
        problem = head_on(closest)
        found.append(
            HardCase(
                f"head-on to {closest:g} D",
                "the pair's stiffness grows like r^-5",
                partial(_as_it_is, problem.scene),
                distance_to(problem),
                "distance from the exact place afterwards [D]",
                1e-2,
                problem.time,
                problem.time,
            )
        )
        found.append(
            HardCase(
                f"head-on to {closest:g} D, energy",
                "the same, judged by its energy",
                partial(_as_it_is, problem.scene),
                energy_change,
                "relative change of the energy afterwards",
                1e-6,
                problem.time,
                problem.time,
            )
        )
    for speed in (1.0, 10.0, 100.0):
        scene = _shot(speed)
        time = scene.protocol[0].span(0.0)
        assert time is not None
        found.append(
            HardCase(
                f"shot at the wall with {speed:g} D/tau",
                "the wall's stiffness grows like w^-4.5",
                partial(_as_it_is, scene),
                energy_change,
                "relative change of the energy afterwards",
                1e-5,
                time,
                time,
            )
        )
    return tuple(found)
