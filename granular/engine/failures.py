"""What went wrong with a run, as a typed error with the remedy."""

from __future__ import annotations

import numpy as np

from granular.engine.state import State
from granular.engine.system import Constants
from granular.scene.scales import Scales
from granular.shared.errors import (
    EnergyError,
    NotAtRestError,
    NotFiniteError,
    OutsideError,
    RunError,
    StepCountError,
)


def misplaced(
    state: State, constants: Constants, scales: Scales, step: int, time: float, remedy: str
) -> RunError:
    """A grain that is where it cannot be, after so many steps, at a time [s]."""
    count = constants.grains
    place = np.stack([state.x[:count], state.y[:count]], axis=1)
    lost = ~np.isfinite(place).all(axis=1)
    if lost.any():
        return NotFiniteError(
            "the position is not finite any more",
            step=step, time=time, grain=int(state.label[np.argmax(lost)]), remedy=remedy,
        )  # fmt: skip
    if state.piston[0] < 0.0:
        value = -float(state.piston[0]) * scales.length
        return OutsideError(
            f"the piston is {value:.3g} m below the bottom, 0 m is the limit",
            step=step, time=time, value=value,
            remedy="give it a wall ('effects.walls.top'), or a path that stays above the bottom",
        )  # fmt: skip
    walls = constants.acting.walls
    gaps = {
        "the left wall": (walls.left, place[:, 0]),
        "the right wall": (walls.right, constants.width - place[:, 0]),
        "the bottom": (walls.bottom, place[:, 1]),
        "the piston": (walls.top, state.piston[0] - place[:, 1]),
    }
    for name, (law, gap) in gaps.items():
        if law is not None and len(gap) and not gap.min() > 0.0:
            value = -float(gap.min()) * scales.length
            return OutsideError(
                f"the grain is {value:.3g} m behind {name}, 0 m is the limit",
                step=step, time=time, grain=int(state.label[gap.argmin()]), value=value,
                remedy=remedy,
            )  # fmt: skip
    if state.far is not None and not np.isfinite(state.far.energy[0]):
        return OutsideError(
            "the bed has spread beyond the mesh of its far field",
            step=step, time=time, remedy="sum the pairs directly ('pairs.method = \"direct\"')",
        )  # fmt: skip
    return NotFiniteError("a force is not finite any more", step=step, time=time, remedy=remedy)


def unbalanced(residual: float, limit: float, step: int, time: float, remedy: str) -> EnergyError:
    """An energy ledger with a residual over the energy turned over, at a time [s]."""
    return EnergyError(
        f"the energy ledger is off by {residual:.2g} of the energy turned over, "
        f"{limit:g} is the limit",
        step=step,
        time=time,
        value=residual,
        remedy=remedy,
    )


def restless(stage: str, limit: float, spread: float, step: int, time: float) -> NotAtRestError:
    """A stage whose piston still ranges over a spread [m] after its longest duration [s]."""
    return NotAtRestError(
        f"stage {stage!r} did not come to rest within {limit:g} s; the piston still ranges over "
        f"{spread:.3g} m",
        step=step,
        time=time,
        value=spread,
        remedy="give the stage a longer duration, a greater tolerance or more dissipation",
    )


def countless(what: str, steps: float, limit: float, step: int, time: float) -> StepCountError:
    """More steps than can be made, or counted."""
    return StepCountError(
        f"{what} takes {steps:.3g} steps, {limit:.3g} is the limit",
        step=step,
        time=time,
        value=steps,
        remedy="check the units of the scene and of t_end, or shorten output.scalars",
    )
