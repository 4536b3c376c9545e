"""One grain stopped by Coulomb friction under a constant normal load N.

It loses a = mu_d N/m of its speed per time until it stops at t_s = v0/a, after v0^2/(2 a). A method
of order two is exact while the grain slides; the step within which it stops is cut into kicks and
drifts whatever the order, and misses the place by a part of a h^2/8 that depends on where in the
step the stop falls. So the worst error falls like h^2, and no method of higher order gains here.
"""

from __future__ import annotations

import math

import numpy as np

from granular.scene.scene import Scene
from validation.exact.constants import DIGITS, natural_units
from validation.exact.problem import Moment, Problem, lone_scene

TIME = 0.078
"""Over the time to the stop this is close to the golden ratio, so that neighbouring numbers of
steps let the stop fall everywhere in its step."""
LOAD = 0.01
"""N [N]: the grain of 0.43 g loses 10.4 m/s^2, a little more than its weight would give it."""


def problem(time: float = TIME) -> Problem:
    """A grain that slides and stops."""
    arrangement = {"positions": [["10 D", "10 D"]], "velocities": [[0.4, 0.3]]}
    effects = {"friction": {"load": LOAD}}
    scene = lone_scene("sliding", time, effects, arrangement=arrangement)
    return Problem(
        "sliding",
        "a grain stopped by dry friction",
        scene,
        time,
        lambda t: moment(scene, t),
        fewest=256,
        conservative=False,
        smooth=False,
    )


def moment(scene: Scene, time: float) -> Moment:
    """Place and velocity at a time [s]."""
    from mpmath import mpf, sqrt, workdps

    friction = scene.effects.friction
    assert friction is not None
    assert scene.arrangement.positions is not None
    assert scene.arrangement.velocities is not None
    with workdps(DIGITS):
        loss = mpf(friction.dynamic) * mpf(friction.load) / natural_units(scene.grains).mass
        start, velocity = scene.arrangement.positions[0], scene.arrangement.velocities[0]
        speed = sqrt(sum(mpf(v) ** 2 for v in velocity))
        late = min(mpf(time), speed / loss)
        way = (speed - loss * late / 2) * late
        left = speed - loss * late
        return Moment(
            np.array(
                [
                    [
                        float(mpf(q) + mpf(v) / speed * way)
                        for q, v in zip(start, velocity, strict=True)
                    ]
                ]
            ),
            np.array([[float(mpf(v) / speed * left) for v in velocity]]),
        )


def stopping_time(scene: Scene) -> float:
    """t_s [s]"""
    assert scene.effects.friction is not None
    assert scene.arrangement.velocities is not None
    speed = math.hypot(*scene.arrangement.velocities[0])
    law = scene.effects.friction
    return speed * float(natural_units(scene.grains).mass) / (law.dynamic * law.load)
