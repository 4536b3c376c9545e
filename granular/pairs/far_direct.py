"""The far field as the sum over all pairs less that over the near ones.

Both are sums over pairs, so action and reaction are equal, and nothing is left out: what is gained
comes from summing all pairs once in several steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.cut_off import cut_sum
from granular.pairs.dipole import ENERGY
from granular.pairs.direct import direct_sum, part_buffers
from granular.pairs.stripe_lists import finite
from granular.pairs.stripes import Stripes


class DirectRoom(NamedTuple):
    """Workspace for the two sums.

    Attributes
    ----------
    near : float64 (2, m)
        Forces of the near part.
    extremes : float64 (2, 2)
        Extremes of all pairs, and of the near ones; see `granular.pairs.direct.direct_sum`.
    buffers : float64 (parts, 5, m) or None
        See `granular.pairs.direct.part_buffers`.
    load : float64 (m,) or None
        Near part of the sums behind the normal force of friction.
    """

    near: np.ndarray
    extremes: np.ndarray
    buffers: np.ndarray | None
    load: np.ndarray | None


def direct_workspace(size: int, *, loaded: bool) -> DirectRoom:
    """Workspace for that many grains (padded)."""
    return DirectRoom(
        near=np.zeros((2, size)),
        extremes=np.zeros((2, 2)),
        buffers=part_buffers(size),
        load=np.zeros(size) if loaded else None,
    )


@compiled
def find_far_direct(
    workspace: DirectRoom, stripes: Stripes, radius: float, threaded: bool | None, grains: int,
    x: Array, y: Array, fx: Array, fy: Array, energy: Array, moments: Array | None,
    load: Array | None, weight: Array | None,
) -> None:  # fmt: skip
    """Overwrite forces, energy and, where grains rub, loads by those of the far part.

    Parameters
    ----------
    room : DirectRoom
    stripes : Stripes
        Stripes of the near part.
    radius : float
        Distance at which the near part ends [D].
    threaded : bool or None
    grains : int
    x, y, fx, fy, moments, load, weight
        As in `granular.pairs.direct.direct_sum`.
    energy : float64 (1,)
    """
    if not finite(x, y, grains):
        fx[:grains] = np.nan
        fy[:grains] = np.nan
        return
    near_x, near_y, every, near = (
        workspace.near[0],
        workspace.near[1],
        workspace.extremes[0],
        workspace.extremes[1],
    )
    direct_sum(x, y, fx, fy, moments, None, every, load, weight, workspace.buffers, threaded, None)
    cut_sum(
        stripes, radius, True, threaded, grains, x, y, near_x, near_y, moments, None, near,
        workspace.load, weight,
    )  # fmt: skip
    for i in range(grains):
        fx[i] -= near_x[i]
        fy[i] -= near_y[i]
    energy[0] = ENERGY * (every[0] - near[0])
    if load is not None and workspace.load is not None:
        for i in range(grains):
            load[i] -= workspace.load[i]
