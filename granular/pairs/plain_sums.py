"""The direct sum once more, as plain as the law is written: the slow twin of `pairs.direct`.

Takes the same arguments; runs without compilation when ``NUMBA_DISABLE_JIT=1``.
"""

from __future__ import annotations

import numpy as np

from granular.compiled import Array
from granular.pairs.dipole import ENERGY, STRENGTH, far_cube, far_fifth, pair_energy, pair_force
from granular.pairs.pair_arrays import PairArrays

PADDING = 1e60
"""Places of padding grains are beyond [D]; they have no images."""


def plain_direct_sum(
    arrays: PairArrays,
    buffers: Array | None,
    threaded: bool | None,
    nearest: Array | None,
) -> None:
    """Pair forces and sums of all grains, one pair at a time."""
    x, y, fx, fy, moments, stiffness, extremes, load, weight = arrays
    for out in (fx, fy, stiffness, extremes, load):
        if out is not None:
            out[:] = 0.0
    q = np.ones(x.size) if moments is None else moments
    # The distance to padding grains overflows, as it should, and that of grains at one place is 0.
    old = np.seterr(over="ignore", divide="ignore", invalid="ignore")
    for i in range(x.size):
        for j in range(i + 1, x.size):
            dx, dy = x[i] - x[j], y[i] - y[j]
            rest = 0.0
            if nearest is not None and max(x[i], x[j]) < PADDING:
                dx -= nearest[0] * np.rint(dx / nearest[0])
                dy -= nearest[1] * np.rint(dy / nearest[1])
            r = np.sqrt(dx * dx + dy * dy)
            if nearest is not None:
                rest = pair_energy(nearest[2]) / ENERGY
                if r >= nearest[2]:
                    continue
            ratio = q[i] * q[j] * pair_force(r) / r
            fx[i] += ratio * dx
            fy[i] += ratio * dy
            fx[j] -= ratio * dx
            fy[j] -= ratio * dy
            fourth = pair_force(r) / STRENGTH
            cube = pair_energy(r) / ENERGY
            if stiffness is not None:
                stiffness[i] += q[j] * fourth / r
                stiffness[j] += q[i] * fourth / r
            if extremes is not None:
                extremes[0] += q[i] * q[j] * (cube - rest)
                extremes[1] = max(extremes[1], fourth / r)
            if load is not None and weight is not None:
                load[i] += weight[j] * cube
                load[j] += weight[i] * cube
    np.seterr(**old)


def plain_cut_sum(
    stripes: object,
    radius: float,
    smooth: bool | None,
    threaded: bool | None,
    grains: int,
    arrays: PairArrays,
) -> None:
    """Pair forces and sums within a radius, where the energy of a pair is zero.

    With ``smooth``, of the near part of the law alone. Of ``stripes`` it takes the sides of a
    periodic cell, where each grain meets the nearest image of every other one.
    """
    x, y, fx, fy, moments, stiffness, extremes, load, weight = arrays
    for out in (fx, fy, stiffness, extremes, load):
        if out is not None:
            out[:] = 0.0
    q = np.ones(x.size) if moments is None else moments
    periods = getattr(stripes, "periods", None)
    for i in range(grains):
        for j in range(i + 1, grains):
            dx, dy = x[i] - x[j], y[i] - y[j]
            if periods is not None:
                dx -= periods[0] * np.rint(dx / periods[0])
                dy -= periods[1] * np.rint(dy / periods[1])
            r = np.sqrt(dx * dx + dy * dy)
            if r < radius:
                pairs = np.array([q[i] * q[j], q[j], q[i]])
                far = 0.0 if smooth is None else float(far_fifth(np.array(r * r), radius))
                ratio = pairs[0] * (pair_force(r) / r - STRENGTH * far)
                for position, sign in ((i, 1.0), (j, -1.0)):
                    fx[position] += sign * ratio * dx
                    fy[position] += sign * ratio * dy
                fifth = pair_force(r) / (STRENGTH * r)
                cube = pair_energy(r) / ENERGY
                rest = pair_energy(radius) / ENERGY
                if smooth is not None:
                    cube, rest = cube - float(far_cube(np.array(r * r), radius)), 0.0
                if stiffness is not None:
                    stiffness[i] += pairs[1] * fifth
                    stiffness[j] += pairs[2] * fifth
                if extremes is not None:
                    extremes[0] += pairs[0] * (cube - rest)
                    extremes[1] = max(extremes[1], fifth)
                if load is not None and weight is not None:
                    load[i] += weight[j] * cube
                    load[j] += weight[i] * cube
