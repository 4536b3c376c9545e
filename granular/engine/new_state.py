"""The arrays of a state, made only for the effects that act."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.kernel_data.constants import EffectLaws
from granular.kernel_data.state import HEIGHT, LOSSES, PISTON, Measurement, StageSlopes, State
from granular.methods import Method
from granular.pairs.direct_sum import pad_coordinates, partial_sum_buffers
from granular.pairs.mesh_far_field import far_field_state
from granular.pairs.near_law import near_law_workspace
from granular.pairs.stripes import stripes_workspace
from granular.pairs.verlet_list import verlet_list_workspace

if TYPE_CHECKING:
    from jaxtyping import Float


def new_state(
    positions: Float[np.ndarray, "n 2"],
    velocities: Float[np.ndarray, "n 2"],
    height: float,
    acting: EffectLaws,
    method: Method,
) -> State:
    """Make the state of a run, with arrays for acting effects alone; height [D], velocities [D/tau]."""
    count = len(positions)
    x, y = pad_coordinates(positions)
    size, with_loads, cut = x.size, acting.weight is not None, acting.cut
    workspaces = tuple(
        law.workspace(size, count) if hasattr(law, "workspace") else None for law in acting.laws
    )
    hosts = [workspace for law, workspace in zip(acting.laws, workspaces, strict=True) if law is acting.host]
    vx, vy = np.zeros_like(x), np.zeros_like(x)
    vx[:count], vy[:count] = velocities[:, 0], velocities[:, 1]
    stripes, stages = None, None
    if cut is not None:
        shifted = acting.shift is not None
        stripes = stripes_workspace(
            size, moments=cut.moments, with_loads=with_loads, shifted=shifted, periods=cut.periods
        )
    if method.tableau is not None:
        rows = len(method.tableau)
        stages = StageSlopes(np.zeros((rows, 4, size)), np.zeros((rows, 2)))
    bodies = np.zeros((2 if acting.host is None else len(acting.host.rows.masses), 4))
    bodies[PISTON, HEIGHT] = height
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        bodies=bodies,
        piston=bodies[PISTON],
        ledger=np.zeros(LOSSES + len(acting.laws)),
        clock=np.array([0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0]),
        wall_forces=np.zeros(len(acting.sides)),
        label=np.arange(size),
        load=np.zeros_like(x) if with_loads else None,
        stripes=stripes,
        verlet_list=None if acting.listing is None else verlet_list_workspace(count, acting.listing),
        far_forces=None if acting.far is None else far_field_state(acting.far, size, with_loads=with_loads),
        near=None if acting.near is None else near_law_workspace(acting.near, count),
        workspaces=workspaces,
        host=hosts[0] if hosts else None,
        scratch=np.zeros_like(x),
        buffers=partial_sum_buffers(size) if cut is None and acting.listing is None else None,
        rounding=np.zeros((4, size)) if method.compensated else None,
        slopes=stages,
    )


def new_measurement(state: State) -> Measurement:
    """Make the scratch of a measuring pass."""
    return Measurement(np.zeros_like(state.x), np.zeros(2), np.zeros_like(state.x))
