"""A piston that descends at constant speed V on one grain at rest, without gravity.

In the piston's frame, which is inertial, the wall stands still and the grain comes at V: with the
distance w = H - y, w'' = (1/2) w^-3.5 and the energy per mass w'^2/2 + (1/5) w^-2.5 stays. One
turning point, the least distance; the quadrature gives w(t) (see `validation.exact.quadrature`) and
the change of frame y = H_0 - V t - w. The piston does work on the grain: its energy is not kept.
"""

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
from validation.exact.quadrature import position_after_turning, time_from_turning

TIME = 0.05
SPEED = 0.5
"""V [m/s]"""
# Distance at the start [D]: the piston's force there is 1/128 of that at one diameter.
GAP = 4.0


def driven_piston_problem(speed: float = SPEED, time: float = TIME) -> ExactProblem:
    """Make the problem of a grain at rest that a piston strikes at constant speed; speed [m/s], time [s]."""
    top = 40.0
    scene = few_grains_scene(
        "driven-piston",
        time,
        {"walls": {"left": "none", "right": "none", "bottom": "none"}},
        arrangement={"positions": [["30 D", f"{top - GAP!r} D"]]},
        piston={"height": f"{top!r} D"},
        protocol=[{"kind": "move", "name": "move", "to": 0.005 * top - speed * time, "duration": time}],
    )
    return ExactProblem("driven-piston", scene, time, partial(exact_driven_piston, scene), fewest_steps=24)


def exact_driven_piston(scene: Scene, time: float) -> GrainStates:
    """Compute place [m] and velocity [m/s], at a time [s], of a grain that a piston drives steadily."""
    from mpmath import findroot, mpf, sqrt, workdps

    from granular.protocol import Move

    move = scene.protocol[0]
    assert scene.piston is not None
    assert isinstance(move, Move)
    assert move.duration is not None
    with workdps(DIGITS):
        units = natural_units(scene.grains)
        height, (x, y) = mpf(scene.piston.height), grain_start_state(scene)[0]
        down = (height - mpf(move.to)) / mpf(move.duration)
        start, speed = (height - mpf(y)) / units.length, down / units.velocity

        def potential(w: object) -> object:
            return mpf(w) ** mpf(-2.5) / 5

        energy = speed**2 / 2 + potential(start)
        turning = findroot(lambda w: potential(w) - energy, (5 * energy) ** mpf(-0.4))
        late = mpf(time) / units.time - time_from_turning(potential, turning, start)
        gap = position_after_turning(potential, turning, late)
        opening = sqrt(2 * abs(energy - potential(gap))) * (1 if late > 0 else -1)
        position = height - down * mpf(time) - gap * units.length
        return GrainStates(
            np.array([[x, float(position)]]), np.array([[0.0, float(-down - opening * units.velocity)]])
        )
