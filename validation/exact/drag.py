"""One grain with viscous drag alone: v = v0 e^(-c t), x = x0 + v0 (1 - e^(-c t))/c, c = gamma/m.

The velocity is exact in every method that takes drag by its flow; the place is not, because the
drift between two half-steps of drag goes at the speed of their middle. So the order shows.
"""

from __future__ import annotations

import numpy as np

from granular.scene.scene import Scene
from validation.exact.constants import DIGITS, natural_units
from validation.exact.problem import Moment, Problem, lone_scene

TIME = 0.1
COEFFICIENT = 0.02
"""gamma [kg/s]: the velocity falls to a hundredth."""


def problem(time: float = TIME) -> Problem:
    """A grain that is slowed down."""
    arrangement = {"positions": [["10 D", "10 D"]], "velocities": [[2.0, 1.0]]}
    effects = {"drag": {"coefficient": COEFFICIENT}}
    scene = lone_scene("drag", time, effects, arrangement=arrangement)
    return Problem(
        "drag",
        "viscous drag alone",
        scene,
        time,
        lambda t: moment(scene, t),
        fewest=8,
        conservative=False,
    )


def moment(scene: Scene, time: float) -> Moment:
    """Place and velocity at a time [s]."""
    from mpmath import exp, expm1, mpf, workdps

    assert scene.effects.drag is not None
    assert scene.arrangement.positions is not None
    assert scene.arrangement.velocities is not None
    with workdps(DIGITS):
        rate = mpf(scene.effects.drag.coefficient) / natural_units(scene.grains).mass
        way = -expm1(-rate * mpf(time)) / rate
        left = exp(-rate * mpf(time))
        start, speed = scene.arrangement.positions[0], scene.arrangement.velocities[0]
        return Moment(
            np.array([[float(mpf(q) + mpf(v) * way) for q, v in zip(start, speed, strict=True)]]),
            np.array([[float(mpf(v) * left) for v in speed]]),
        )
