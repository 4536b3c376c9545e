"""The far field as the sum over all pairs less that over the near ones.

Both are sums over pairs, so action and reaction are equal, and nothing is left out: what is gained
comes from summing all pairs once in several steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.cut_off_sum import cut_off_sum
from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import direct_sum, partial_sum_buffers
from granular.pairs.grain_arrays import (
    GrainArrays,
    replace_energy_and_closest,
    replace_sums,
    set_forces_to_nan,
)
from granular.pairs.near_list import positions_are_finite
from granular.pairs.stripes import Stripes

if TYPE_CHECKING:
    from jaxtyping import Float


class DirectFarFieldWorkspace(NamedTuple):
    """Workspace for the two sums."""

    near: Float[np.ndarray, "2 m"]  # forces of the near part, along x and y [F*]
    energy_and_closest: Float[np.ndarray, "2 2"]  # of all pairs; of the near ones
    buffers: Float[np.ndarray, "parts 5 m"] | None  # see `partial_sum_buffers`
    load: Float[np.ndarray, "m"] | None  # near part of the sums behind the normal force [1/D^3]


def direct_far_field_workspace(size: int, *, with_loads: bool) -> DirectFarFieldWorkspace:
    """Allocate the arrays of a far field that is the sum over all pairs less that over near pairs."""
    return DirectFarFieldWorkspace(
        near=np.zeros((2, size)),
        energy_and_closest=np.zeros((2, 2)),
        buffers=partial_sum_buffers(size),
        load=np.zeros(size) if with_loads else None,
    )


@compiled(inline=True)
def _subtract_if_wanted(values: Array | None, other: Array | None, grains: int) -> None:
    if values is not None and other is not None:
        for i in range(grains):
            values[i] -= other[i]


@compiled
def compute_direct_far_field(
    workspace: DirectFarFieldWorkspace,
    stripes: Stripes,
    radius: float,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
    energy: Float[Array, "1"],
) -> None:
    """Overwrite forces [F*], energy [F* D] and, if wanted, loads [1/D^3] by the far part; radius [D]."""
    if not positions_are_finite(arrays.x, arrays.y, grains):
        set_forces_to_nan(arrays, grains)
        return
    forces, every, near = workspace.near, workspace.energy_and_closest[0], workspace.energy_and_closest[1]
    direct_sum(replace_energy_and_closest(arrays, every), workspace.buffers, threaded, None)
    close = replace_sums(arrays, forces[0], forces[1], None, near, workspace.load)
    cut_off_sum(stripes, radius, True, threaded, grains, close)
    _subtract_if_wanted(arrays.fx, forces[0], grains)
    _subtract_if_wanted(arrays.fy, forces[1], grains)
    _subtract_if_wanted(arrays.load, workspace.load, grains)
    energy[0] = ENERGY * (every[0] - near[0])
