"""Free fall: y = y0 + v0 t - g t^2/2 ([D, 2.18] prints g t^2).

Every method of order two or more is exact here, so only rounding is left; a method of order one
misses by g t h/2, the controls' slope.
"""

from __future__ import annotations

import numpy as np

from granular.scene.scene import Scene
from validation.exact.constants import DIGITS
from validation.exact.problem import Moment, Problem, lone_scene

TIME = 0.25


def problem() -> Problem:
    """A grain thrown upwards and sideways; natural frequencies there are none."""
    arrangement = {"positions": [["20 D", "40 D"]], "velocities": [[0.1, 0.5]]}
    scene = lone_scene("free-fall", TIME, {"gravity": {}}, arrangement=arrangement)
    return Problem(
        "free-fall", "free fall", scene, TIME, lambda time: moment(scene, time), fewest=16
    )


def moment(scene: Scene, time: float) -> Moment:
    """Place and velocity at a time [s]."""
    from mpmath import mpf, workdps

    assert scene.effects.gravity is not None
    assert scene.arrangement.positions is not None
    assert scene.arrangement.velocities is not None
    with workdps(DIGITS):
        t, g = mpf(time), mpf(scene.effects.gravity.acceleration)
        (x, y), (vx, vy) = scene.arrangement.positions[0], scene.arrangement.velocities[0]
        return Moment(
            np.array([[float(mpf(x) + mpf(vx) * t), float(mpf(y) + mpf(vy) * t - g * t * t / 2)]]),
            np.array([[vx, float(mpf(vy) - g * t)]]),
        )
