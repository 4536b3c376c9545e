"""Relaxation of a bed downhill, by the fast inertial relaxation engine (FIRE).

Numbers as published (Bitzek et al. 2006, doi:10.1103/PhysRevLett.97.170201). Each coordinate has its
stiffness for a mass, so that all have one period; the time step is over it.
"""

from __future__ import annotations

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.shared.array_types import Float

_STEP, _LONGEST_STEP, _MIXING, _LATENCY, _MOST_STEPS = 0.1, 1.0, 0.1, 5, 20_000
_LONGEST_MOVE = 0.05
"""Longest move of a grain in a step [D], so that none passes through another one or a wall."""

SOFTEST = 1e-3
"""Smallest mass over the largest one: a grain that touches nothing has hardly a stiffness."""

RELAXED = 1e-6
"""Largest force over the first one at which Newton's method takes over."""


def relax(
    bed: BedForces,
    start: Float[np.ndarray, "q"],
    held: tuple[int, ...],
    stiffness: Float[np.ndarray, "q"],
    reduction: float,
) -> Float[np.ndarray, "q"]:
    """Follow the forces from a start [m] until they are as small as wanted, over the first ones.

    The stiffness of each coordinate alone [N/m] is its mass.
    """
    sizes = np.abs(stiffness)
    scaling = 1.0 / np.sqrt(np.maximum(sizes, SOFTEST * sizes.max()))
    at, velocity, step = start, np.zeros_like(start), _STEP
    mixing, downhill, first = _MIXING, 0, 0.0
    for _ in range(_MOST_STEPS):
        force = scaling * bed.forces(at)
        force[list(held)] = 0.0
        size = float(np.linalg.norm(force))
        first = first or size
        if size <= reduction * first:
            break
        if force @ velocity > 0.0:
            velocity = (1.0 - mixing) * velocity + mixing * np.linalg.norm(velocity) * force / size
            downhill += 1
            if downhill > _LATENCY:
                step, mixing = min(1.1 * step, _LONGEST_STEP), 0.99 * mixing
        else:
            velocity, step, mixing, downhill = np.zeros_like(at), 0.5 * step, _MIXING, 0
        velocity = velocity + step * force
        move = step * scaling * velocity
        at = at + move * min(1.0, _LONGEST_MOVE * bed.length / float(np.abs(move).max()))
    return at
