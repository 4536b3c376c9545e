"""The direct sum once more, as plain as the law is written: the slow twin of `pairs.direct`.

Takes the same arguments; runs without compilation when ``NUMBA_DISABLE_JIT=1``.
"""

from __future__ import annotations

import math

import numpy as np

from granular.compiled import Array
from granular.effects.dipole import STRENGTH


def plain_direct_sum(
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    charge: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    load: Array | None,
    weight: Array | None,
    buffers: Array | None,
    threaded: bool | None,
) -> None:
    """Pair forces and sums of all grains, one pair at a time."""
    for out in (fx, fy, stiffness, extremes, load):
        if out is not None:
            out[:] = 0.0
    q = np.ones(x.size) if charge is None else charge
    old = np.seterr(over="ignore")  # the distance to padding grains overflows, as it should
    for i in range(x.size):
        for j in range(i + 1, x.size):
            dx, dy = x[i] - x[j], y[i] - y[j]
            r2 = dx * dx + dy * dy
            s = 1.0 / (r2 * r2 * math.sqrt(r2)) if r2 > 0.0 else math.inf
            strength = STRENGTH * q[i] * q[j] * s
            fx[i] += strength * dx
            fy[i] += strength * dy
            fx[j] -= strength * dx
            fy[j] -= strength * dy
            if stiffness is not None:
                stiffness[i] += q[j] * s
                stiffness[j] += q[i] * s
            if extremes is not None:
                extremes[0] += q[i] * q[j] * r2 * s
                extremes[1] = max(extremes[1], s)
            if load is not None and weight is not None:
                load[i] += weight[j] * r2 * s
                load[j] += weight[i] * r2 * s
    np.seterr(**old)
