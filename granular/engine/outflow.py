"""Grains that have left through a gap are taken out."""

from __future__ import annotations

import numpy as np

from granular.effects.wall_discs import DiscWall
from granular.kernel_data.constants import Constants
from granular.kernel_data.state import State
from granular.pairs.direct_sum import PADDING


def constants_per_grain(constants: Constants) -> list[np.ndarray]:
    """Constants with one value for each grain (m,), which must move with the grains."""
    acting = constants.acting
    result = [constants.masses, constants.moments, acting.weight, acting.charges, acting.shift]
    if acting.near is not None:
        result.append(acting.near.species)
    result += [side.law.species for side in acting.sides if isinstance(side.law, DiscWall)]
    # A law's arrays are all of this kind; any other stands in a tuple of its own within the law.
    result += [values for law in acting.laws for values in law]
    # Masses, moments and charges may be one array, and must not be moved twice.
    return list({id(values): values for values in result if isinstance(values, np.ndarray)}.values())


def remove_outflowed_grains(state: State, constants: Constants) -> Constants:
    """Take out the grains below the exit, by moving the last ones to their entries."""
    grains = constants.grains
    for i in range(grains - 1, -1, -1):
        if state.y[i] < constants.exit:
            grains -= 1
            _replace_by_last_grain(i, grains, state, constants)
    state.scratch[:] = 0.0
    for workspace in state.workspaces:
        if isinstance(workspace, np.ndarray):
            workspace[:] = 0.0
    return constants._replace(grains=grains)


def _replace_by_last_grain(i: int, last: int, state: State, constants: Constants) -> None:
    """Swap a grain with the last one, and put padding in the last entry."""
    moving = [state.x, state.y, state.vx, state.vy, state.label, *constants_per_grain(constants)]
    if state.rounding is not None:
        moving += list(state.rounding)
    for values in moving:
        values[[i, last]] = values[[last, i]]
    state.x[last], state.y[last] = PADDING * (last + 1.0), 0.0
    state.vx[last] = state.vy[last] = 0.0
    if state.rounding is not None:
        state.rounding[:, last] = 0.0
