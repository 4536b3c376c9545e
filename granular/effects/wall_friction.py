"""Dry sliding friction of the grains at the side walls: all sides of the cell that are not horizontal.

A side wall that exerts the normal force N on a grain also exerts a friction force of at most mu N, against
the grain's motion along the wall (Coulomb; Popov, Contact Mechanics and Friction (2010), 10). Here N is the
magnetic force of the wall. The motion along a wall is one-dimensional, and is solved exactly under constant
force, drag and friction: a sliding grain stops, and then stays exactly at rest while the force along the wall
does not exceed mu N. If a grain interacts with several sides that are not parallel, the motion along the side
with the largest normal force is solved exactly. The friction at the other sides is applied before this
solution in the first half of a step, and after it in the second half.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import make_hook_sum_kernel
from granular.effects import drag
from granular.effects.drag import (
    exact_drag_step_factors,
    slide_under_drag_and_friction,
    velocity_and_loss_under_drag,
)
from granular.effects.effect import DissipativeEffect, Effect, EffectContext, recorded_energy_variable
from granular.effects.wall_side import PARALLEL, Side
from granular.effects.walls import sides_in_natural_units
from granular.kernel_data.state import CELL, LOSSES, Bed, relative_moments
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell, SideLine
from granular.schema.field_kinds import FieldError
from granular.schema.sections import quantity
from granular.shared.array_types import Float


class WallFriction(DissipativeEffect):
    """Coulomb friction at the side walls.

    Attributes
    ----------
    coefficient : float
        Friction coefficient mu, the same at rest and in motion.
    """

    key = "wall_friction"
    example: ClassVar[Any] = {"coefficient": 0.3}
    dry = True
    damps = True
    solved_together_with = ("drag",)
    loss_record = recorded_energy_variable("wall_friction_loss", "energy lost to friction at the side walls")

    coefficient: float = quantity("1", least=0.0)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that the cell has a side wall, and that wall forces depend only on the distance."""
        walls: Any = others.get("walls")
        rubbing = (
            [] if walls is None else [walls.wall_of(line.name) for line in _side_lines_with_friction(cell)]
        )
        if not any(rubbing):
            raise FieldError(
                "the cell has no side wall for friction; add one to effects.walls", "effects", self.key
            )
        if any(wall is not None and wall.law in ("slab", "discs") for wall in rubbing):
            raise FieldError(
                "requires wall forces that depend only on the distance, but a wall is a slab or discs; "
                "use 'infinite'",
                "effects",
                self.key,
            )

    def make_kernel_law(self, context: EffectContext) -> WallFrictionLaw:
        """Make the law for the compiled loop, including viscous drag."""
        walls: Any = context.effects["walls"]
        sides = sides_in_natural_units(walls, context, _side_lines_with_friction(context.cell))
        directions = list[tuple[float, float]]()
        for side in sides:
            if all(abs(side.tx * ty - side.ty * tx) > PARALLEL for tx, ty in directions):
                directions.append((side.tx, side.ty))
        taken = drag.drag_rates_and_ledger_index(context)
        return WallFrictionLaw(self.coefficient, sides, tuple(directions), *taken)


def _side_lines_with_friction(cell: Cell) -> tuple[SideLine, ...]:
    """Sides with friction: all fixed sides of the cell that are not horizontal."""
    return tuple(line for line in cell.lines if line.body == CELL and not line.is_level)


_pressing_force = make_hook_sum_kernel("pressing_force", "x y tx ty", 0.0)


class WallFrictionLaw(NamedTuple):
    """Friction at the side walls in natural units, for the compiled loop."""

    coefficient: float
    sides: tuple[Side, ...]
    directions: tuple[tuple[float, float], ...]  # unit vectors along the sides; parallel sides share one
    kind: Float[Array, "m"] | None  # of the drag that is solved together, as in `DragLaw`
    rates: drag.DragRateTable
    drag: int | None  # ledger index of the loss to drag

    @staticmethod
    @compiled
    def kick(law: WallFrictionLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        """Kick the grains by force, drag and wall friction together, exactly; dt [tau]."""
        state, constants = bed.state, bed.constants
        masses, rubbed, dragged = constants.masses, 0.0, 0.0
        for k in range(len(law.rates.values)):
            rate = law.rates.values[k]
            flow = exact_drag_step_factors(rate, dt)
            for i in range(constants.grains):
                if not drag.has_drag_rate_index(law.kind, i, k):
                    continue
                mass, (tx, ty, hold) = (
                    value_or_one(masses, i),
                    _direction_and_magnitude_of_largest_friction(law, bed, i),
                )
                if opens_step:
                    rubbed += _apply_friction_at_other_sides(law, bed, i, tx, ty, dt)
                vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
                across, _, lost = velocity_and_loss_under_drag(
                    flow, tx * vy - ty * vx, 0.0, (tx * fy - ty * fx) / mass, 0.0
                )
                dragged += mass * lost
                velocity, force = (0.0, tx * vx + ty * vy), (0.0, tx * fx + ty * fy)
                _, along, by_drag, by_friction = slide_under_drag_and_friction(
                    rate, dt, flow, mass, velocity, force, 1.0, 1.0, hold
                )
                state.vx[i], state.vy[i] = tx * along - ty * across, ty * along + tx * across
                rubbed += by_friction
                dragged += by_drag
                if not opens_step:
                    rubbed += _apply_friction_at_other_sides(law, bed, i, tx, ty, dt)
        state.ledger[LOSSES + index] += rubbed
        drag.add_drag_loss_to_ledger(law.drag, state, dragged)
        return 0


@compiled
def _maximum_friction_along_direction(law: WallFrictionLaw, bed: Bed, i: int, tx: float, ty: float) -> float:
    """Maximum friction on a grain at the sides parallel to a direction [F*]."""
    state = bed.state
    normal = _pressing_force(law.sides, law.sides, state.x[i], state.y[i], tx, ty)
    return law.coefficient * value_or_one(relative_moments(bed.constants), i) * normal


@compiled
def _direction_and_magnitude_of_largest_friction(
    law: WallFrictionLaw, bed: Bed, i: int
) -> tuple[float, float, float]:
    """Return the direction along which friction on a grain can be largest, and this friction [F*]."""
    tx, ty = law.directions[0]
    hold = _maximum_friction_along_direction(law, bed, i, tx, ty)
    for k in range(1, len(law.directions)):
        other_x, other_y = law.directions[k]
        other = _maximum_friction_along_direction(law, bed, i, other_x, other_y)
        if other > hold:
            tx, ty, hold = other_x, other_y, other
    return tx, ty, hold


@compiled
def _apply_friction_at_other_sides(
    law: WallFrictionLaw, bed: Bed, i: int, tx: float, ty: float, dt: float
) -> float:
    """Apply friction along all directions except one; return the energy lost [F* D]."""
    state, mass, lost = bed.state, value_or_one(bed.constants.masses, i), 0.0
    for k in range(len(law.directions)):
        x, y = law.directions[k]
        if x == tx and y == ty:
            continue
        v = x * state.vx[i] + y * state.vy[i]
        taken = min(abs(v), dt * _maximum_friction_along_direction(law, bed, i, x, y) / mass)
        state.vx[i] -= math.copysign(taken, v) * x
        state.vy[i] -= math.copysign(taken, v) * y
        lost += 0.5 * mass * taken * (2.0 * abs(v) - taken)
    return lost
