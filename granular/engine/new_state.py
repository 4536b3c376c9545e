"""The arrays of a state, made only for the effects that act."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from granular.kernel_data.constants import EffectLaws
from granular.kernel_data.state import LOSSES, Measurement, StageSlopes, State
from granular.methods import Method
from granular.pairs.direct_sum import pad_coordinates, partial_sum_buffers
from granular.pairs.mesh_far_field import FarFieldState, far_field_state
from granular.pairs.near_law import near_law_workspace
from granular.pairs.stripes import Stripes, stripes_workspace
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
    workspaces = tuple(_law_workspace(law, x.size, count) for law in acting.laws)
    hosts = [workspace for law, workspace in zip(acting.laws, workspaces, strict=True) if law is acting.host]
    vx, vy = np.zeros_like(x), np.zeros_like(x)
    vx[:count], vy[:count] = velocities[:, 0], velocities[:, 1]
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        piston=np.array([height, 0.0, 0.0, 0.0]),
        ledger=np.zeros(LOSSES + len(acting.laws)),
        clock=np.array([0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0]),
        wall_forces=np.zeros(4),
        label=np.arange(x.size),
        load=None if acting.weight is None else np.zeros_like(x),
        stripes=_new_stripes(x.size, acting),
        verlet_list=None if acting.listing is None else verlet_list_workspace(count, acting.listing),
        far_forces=_new_far_forces(x.size, acting),
        near=None if acting.near is None else near_law_workspace(acting.near, count),
        workspaces=workspaces,
        host=hosts[0] if hosts else None,
        scratch=np.zeros_like(x),
        buffers=partial_sum_buffers(x.size) if acting.cut is None and acting.listing is None else None,
        rounding=np.zeros((4, x.size)) if method.compensated else None,
        slopes=None if method.tableau is None else _new_slopes(len(method.tableau), x.size),
    )


def _law_workspace(law: Any, size: int, count: int) -> Any:
    return law.workspace(size, count) if hasattr(law, "workspace") else None


def _new_stripes(size: int, acting: EffectLaws) -> Stripes | None:
    if acting.cut is None:
        return None
    cut = acting.cut
    return stripes_workspace(
        size,
        moments=cut.moments,
        with_loads=acting.weight is not None,
        shifted=acting.shift is not None,
        periods=cut.periods,
    )


def _new_far_forces(size: int, acting: EffectLaws) -> FarFieldState | None:
    if acting.far is None:
        return None
    return far_field_state(acting.far, size, with_loads=acting.weight is not None)


def _new_slopes(rows: int, size: int) -> StageSlopes:
    return StageSlopes(np.zeros((rows, 4, size)), np.zeros((rows, 2)))


def new_measurement(state: State) -> Measurement:
    """Make the scratch of a measuring pass."""
    return Measurement(np.zeros_like(state.x), np.zeros(2), np.zeros_like(state.x))
