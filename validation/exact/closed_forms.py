"""Motions of one grain in closed form: free fall, viscous drag, Coulomb friction."""

from __future__ import annotations

from functools import partial

import numpy as np

from granular.scene.scene import Scene
from validation.exact.problem import (
    DIGITS,
    ExactProblem,
    GrainStates,
    few_grains_scene,
    grain_start_state,
    natural_units,
)

# Free fall --------------------------------------------------------------------------------------


def free_fall_problem(time: float = 0.25) -> ExactProblem:
    """Grain thrown upwards and sideways: y = y0 + v0 t - g t^2/2 ([D, 2.18] prints g t^2); time [s]."""
    # Exact in every method of order two or more, but for rounding; order one misses by g t h/2.
    arrangement = {"positions": [["20 D", "40 D"]], "velocities": [[0.1, 0.5]]}
    scene = few_grains_scene("free-fall", time, {"gravity": {}}, arrangement=arrangement)
    return ExactProblem("free-fall", scene, time, partial(_exact_free_fall, scene), fewest_steps=16)


def _exact_free_fall(scene: Scene, time: float) -> GrainStates:
    """Grain at a time [s]; places [m], velocities [m/s]."""
    from mpmath import mpf, workdps

    assert scene.effects.gravity is not None
    with workdps(DIGITS):
        t, g = mpf(time), mpf(scene.effects.gravity.acceleration)
        (x, y), (vx, vy) = grain_start_state(scene)
        return GrainStates(
            np.array([[float(mpf(x) + mpf(vx) * t), float(mpf(y) + mpf(vy) * t - g * t * t / 2)]]),
            np.array([[vx, float(mpf(vy) - g * t)]]),
        )


# Viscous drag -----------------------------------------------------------------------------------

COEFFICIENT = 0.02
"""gamma [kg/s]: the velocity falls to a hundredth."""


def drag_problem(time: float = 0.1) -> ExactProblem:
    """Viscous drag alone: v = v0 e^(-c t), x = x0 + v0 (1 - e^(-c t))/c, c = gamma/m; time [s]."""
    # The velocity is exact in every method that takes drag by its flow. The place is not: between two half
    # steps of drag the drift goes at the speed of their middle, and so the order shows.
    arrangement = {"positions": [["10 D", "10 D"]], "velocities": [[2.0, 1.0]]}
    effects = {"drag": {"coefficient": COEFFICIENT}}
    scene = few_grains_scene("drag", time, effects, arrangement=arrangement)
    return ExactProblem("drag", scene, time, partial(_exact_drag, scene), fewest_steps=8)


def _exact_drag(scene: Scene, time: float) -> GrainStates:
    """Grain at a time [s]."""
    from mpmath import exp, expm1, mpf, workdps

    assert scene.effects.drag is not None
    with workdps(DIGITS):
        rate = mpf(scene.effects.drag.coefficient) / natural_units(scene.grains).mass
        factor = -expm1(-rate * mpf(time)) / rate
        left = exp(-rate * mpf(time))
        start, speed = grain_start_state(scene)
        positions = [mpf(q) + mpf(v) * factor for q, v in zip(start, speed, strict=True)]
        return GrainStates(
            np.array([[float(q) for q in positions]]), np.array([[float(mpf(v) * left) for v in speed]])
        )


# Coulomb friction -------------------------------------------------------------------------------

SLIDING_TIME = 0.078
"""Duration of sliding [s], whose ratio to the time to the stop is near the golden one: neighbouring
numbers of steps then let the stop fall everywhere in its step."""

LOAD = 0.01
"""N [N]: the grain of 0.43 g loses 10.4 m/s^2, a little more than its weight would give it."""


def sliding_problem(time: float = SLIDING_TIME) -> ExactProblem:
    """Grain stopped by Coulomb friction under a constant normal load N; time [s]."""
    # It loses a = mu_d N/m of its speed per time and stops at t_s = v0/a, after v0^2/(2 a). The step of the
    # stop misses the place by a part of a h^2/8 whatever the order, so the worst error falls like h^2.
    arrangement = {"positions": [["10 D", "10 D"]], "velocities": [[0.4, 0.3]]}
    scene = few_grains_scene("sliding", time, {"friction": {"load": LOAD}}, arrangement=arrangement)
    return ExactProblem(
        "sliding", scene, time, partial(_exact_sliding, scene), fewest_steps=256, smooth=False
    )


def _exact_sliding(scene: Scene, time: float) -> GrainStates:
    """Grain at a time [s]."""
    from mpmath import mpf, sqrt, workdps

    friction = scene.effects.friction
    assert friction is not None
    with workdps(DIGITS):
        loss = mpf(friction.dynamic) * mpf(friction.load) / natural_units(scene.grains).mass
        start, velocity = grain_start_state(scene)
        speed = sqrt(sum(mpf(v) ** 2 for v in velocity))
        late = min(mpf(time), speed / loss)
        distance = (speed - loss * late / 2) * late
        left = speed - loss * late
        along = [mpf(v) / speed for v in velocity]
        positions = [mpf(q) + e * distance for q, e in zip(start, along, strict=True)]
        return GrainStates(
            np.array([[float(q) for q in positions]]), np.array([[float(e * left) for e in along]])
        )
