"""Errors of a run, each with its remedy."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np

from granular.effects.wall_discs import DiscWall
from granular.kernel_data.state import HEIGHT, PISTON, Constants, State
from granular.pairs.disc_law import CLOSEST
from granular.pairs.near_law import minimum_stop_distance_ratio_and_grain
from granular.schema.cell import SideLine, piston_wall_key
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, NotAtRestError, NotFiniteError, OutsideError, RunError


def misplaced_grain_error(
    state: State,
    constants: Constants,
    lines: tuple[SideLine, ...],
    scales: Scales,
    step: int,
    time: float,
    remedy: str,
) -> RunError:
    """Make the error for a grain at an impossible position; ``time`` in s."""
    count = constants.grains
    common: dict[str, Any] = {"step": step, "time": time}
    position = np.stack([state.x[:count], state.y[:count]], axis=1)
    lost = ~np.isfinite(position).all(axis=1)
    if lost.any():
        grain = int(state.label[np.argmax(lost)])
        return NotFiniteError("the position is no longer finite", grain=grain, remedy=remedy, **common)
    if state.piston[HEIGHT] < 0.0:
        value = -float(state.piston[HEIGHT]) * scales.length
        return OutsideError(
            f"the piston is {value:.3g} m below the bottom of the cell, and the limit is 0 m",
            value=value,
            remedy=f"give the piston a wall ({piston_wall_key(lines)}), or a path above the bottom",
            **common,
        )
    for line, side in zip(lines, constants.acting.sides, strict=True):
        law = side.law
        height, points = state.piston[HEIGHT] * scales.length, position * scales.length
        if side.body > PISTON:
            points = points - [0.0, state.bodies[side.body, HEIGHT] * scales.length]
        gap = line.distances_from_side(points, height)
        held = getattr(law, "closed", law is not None)  # grains may be behind a slab with a gap
        if held and len(gap) and not gap.min() > 0.0:
            value, grain = -float(gap.min()), int(state.label[gap.argmin()])
            message = f"the grain is {value:.3g} m behind {line.label}, and the limit is 0 m"
            if isinstance(law, DiscWall):  # the repulsion of discs is finite, and contact acts only on pairs
                remedy = (
                    "with any time step, a hard impact pushes grains into a row of magnets; let the piston "
                    "fall from a smaller height ('piston.height', 'arrangement.height'), or make it lighter "
                    "('piston.mass')"
                )
            return OutsideError(message, grain=grain, value=value, remedy=remedy, **common)
    if state.far_forces is not None and not np.isfinite(state.far_forces.energy[0]):
        return OutsideError(
            "the bed has spread beyond the mesh of its far field",
            remedy="sum the pairs directly ('pairs.method = \"direct\"')",
            **common,
        )
    if constants.acting.near is not None:
        ratio, grain = minimum_stop_distance_ratio_and_grain(
            constants.acting.near, state.near, count, state.x, state.y
        )
        if ratio < 1.0:
            ratio *= CLOSEST
            return OutsideError(
                f"the distance of two discs is {ratio:.3g} times the distance at which they touch, and the "
                f"limit is {CLOSEST:g}",
                grain=int(state.label[grain]),
                value=ratio,
                remedy="give the discs a stiff enough contact ('effects.contact.modulus')",
                **common,
            )
    return NotFiniteError("a force is no longer finite", remedy=remedy, **common)


def not_at_rest_error(
    stage: str, limit: float, speeds: tuple[float, float], tolerance: float, step: int, time: float
) -> NotAtRestError:
    """Make the error for a piston that does not come to rest; all arguments in SI units."""
    piston, grain = speeds
    remedy = "give the stage a longer duration, a larger tolerance or more dissipation"
    if not grain:
        remedy += ", or give the piston friction (piston.friction), because sticking grains do not damp it"
    return NotAtRestError(
        f"stage {stage!r} did not come to rest within {limit:g} s: the piston still moves at "
        f"{piston:.2g} m/s, the fastest grain at {grain:.2g} m/s, and the piston does not stay "
        f"within {tolerance:.2g} m",
        step=step,
        time=time,
        value=max(piston, grain),
        remedy=remedy,
    )


@contextlib.contextmanager
def report_arithmetic_errors_as(failure: Callable[[], Exception]) -> Iterator[None]:
    """Convert arithmetic errors in kernels to ``failure()`` if the kernels run without the compiler."""
    try:
        yield
    except (ArithmeticError, ValueError) as error:
        # Compiled code continues with infinities, which the loop reports.
        if not numba.config.DISABLE_JIT or isinstance(error, InputError):
            raise
        raise failure() from error
