"""Relaxation of a bed downhill, by the fast inertial relaxation engine (FIRE).

Numbers as published (Bitzek et al. 2006, doi:10.1103/PhysRevLett.97.170201); the time step is over the period
of the stiffest coordinate alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.linear.bed_forces import BedForces

if TYPE_CHECKING:
    from jaxtyping import Float

_STEP, _LONGEST_STEP, _MIXING, _LATENCY, _MOST_STEPS = 0.1, 1.0, 0.1, 5, 20_000
_LONGEST_MOVE = 0.05
"""Longest move of a grain in a step [D], so that none passes through another one or a wall."""

RELAXED = 1e-6
"""Largest force over the first one at which Newton's method takes over."""


def relax(
    bed: BedForces, start: Float[np.ndarray, "q"], held: tuple[int, ...], stiffest: float, reduction: float
) -> Float[np.ndarray, "q"]:
    """Follow the forces from a start [m] until they are as small as wanted, over the first ones.

    The largest stiffness of a coordinate [N/m] sets the step.
    """
    at, velocity = start, np.zeros_like(start)
    step, longest = _STEP / np.sqrt(stiffest), _LONGEST_STEP / np.sqrt(stiffest)
    mixing, downhill, first = _MIXING, 0, 0.0
    for _ in range(_MOST_STEPS):
        force = bed.forces(at)
        force[list(held)] = 0.0
        size = float(np.linalg.norm(force))
        first = first or size
        if size <= reduction * first:
            break
        if force @ velocity > 0.0:
            velocity = (1.0 - mixing) * velocity + mixing * np.linalg.norm(velocity) * force / size
            downhill += 1
            if downhill > _LATENCY:
                step, mixing = min(1.1 * step, longest), 0.99 * mixing
        else:
            velocity, step, mixing, downhill = np.zeros_like(at), 0.5 * step, _MIXING, 0
        velocity = velocity + step * force
        move = step * velocity
        at = at + move * min(1.0, _LONGEST_MOVE * bed.length / float(np.abs(move).max()))
    return at
