"""Dry sliding friction of the grains at the side walls: all sides of the cell that are not level.

A grain that a side wall pushes with the force N rubs along it with at most mu N, against its motion
along the wall (Coulomb; Popov, Contact Mechanics and Friction (2010), 10). N is the wall's own
magnetic force on the grain. Along a wall the motion is one-dimensional, and under constant force,
drag and friction it is solved exactly: a grain that slides stops and stays, to the last bit, while
the force along the wall is at most mu N. Between sides that are not parallel this is so along the
one that presses the grain most; the friction at the others slows it before that, or after that in
the half of a step that closes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import sum_of_hooks
from granular.effects import drag
from granular.effects.drag import drag_flow_coefficients, move_with_drag, slide
from granular.effects.effect import DissipativeEffect, Effect, EffectContext, energy_variable
from granular.effects.wall_side import PARALLEL, Side
from granular.effects.walls import natural_sides
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
        mu, at rest and in motion.
    """

    key = "wall_friction"
    example: ClassVar[Any] = {"coefficient": 0.3}
    dry = True
    damps = True
    takes_along = ("drag",)
    loss_record = energy_variable("wall_friction_loss", "energy lost to friction at the side walls")

    coefficient: float = quantity("1", least=0.0)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that a side wall is there, whose force is a law of the distance alone."""
        walls: Any = others.get("walls")
        rubbing = [] if walls is None else [walls.wall_of(line.name) for line in _rubbing_lines(cell)]
        if not any(rubbing):
            raise FieldError("there is no side wall to rub at; give effects.walls", "effects", self.key)
        if any(wall is not None and wall.law in ("slab", "discs") for wall in rubbing):
            raise FieldError(
                "slabs and discs have no law of the distance alone; take 'infinite'", "effects", self.key
            )

    def make_kernel_law(self, context: EffectContext) -> WallFrictionLaw:
        """Make the law that the compiled loop takes; it takes the drag along."""
        walls: Any = context.effects["walls"]
        sides = natural_sides(walls, context, _rubbing_lines(context.cell))
        directions = list[tuple[float, float]]()
        for side in sides:
            if all(abs(side.tx * ty - side.ty * tx) > PARALLEL for tx, ty in directions):
                directions.append((side.tx, side.ty))
        taken = drag.drag_taken_along(context)
        return WallFrictionLaw(self.coefficient, sides, tuple(directions), *taken)


def _rubbing_lines(cell: Cell) -> tuple[SideLine, ...]:
    """Sides at which grains rub: those of the cell that are not level."""
    return tuple(line for line in cell.lines if line.body == CELL and not line.is_level)


_pressing_force = sum_of_hooks("pressing_force", "x y tx ty", 0.0)


class WallFrictionLaw(NamedTuple):
    """Friction at the side walls as the kernels take it."""

    coefficient: float
    sides: tuple[Side, ...]
    directions: tuple[tuple[float, float], ...]  # unit vectors along the sides, of parallel sides once
    kind: Float[Array, "m"] | None  # of the drag that is solved along, as in `DragLaw`
    rates: drag.DragRateTable
    drag: int | None  # index in the ledger of the loss to drag

    @staticmethod
    @compiled
    def kick(law: WallFrictionLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        """Kick the grains by force, drag and wall friction, together and exactly; dt [tau]."""
        state, constants = bed.state, bed.constants
        masses, rubbed, dragged = constants.masses, 0.0, 0.0
        for k in range(len(law.rates.values)):
            rate = law.rates.values[k]
            flow = drag_flow_coefficients(rate, dt)
            for i in range(constants.grains):
                if not drag.is_of_drag_kind(law.kind, i, k):
                    continue
                mass, (tx, ty, hold) = value_or_one(masses, i), _strongest_direction(law, bed, i)
                if opens_step:
                    rubbed += _rub_at_other_sides(law, bed, i, tx, ty, dt)
                vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
                across, _, lost = move_with_drag(
                    flow, tx * vy - ty * vx, 0.0, (tx * fy - ty * fx) / mass, 0.0
                )
                dragged += mass * lost
                velocity, force = (0.0, tx * vx + ty * vy), (0.0, tx * fx + ty * fy)
                _, along, by_drag, by_friction = slide(rate, dt, flow, mass, velocity, force, 1.0, 1.0, hold)
                state.vx[i], state.vy[i] = tx * along - ty * across, ty * along + tx * across
                rubbed += by_friction
                dragged += by_drag
                if not opens_step:
                    rubbed += _rub_at_other_sides(law, bed, i, tx, ty, dt)
        state.ledger[LOSSES + index] += rubbed
        drag.record_drag_loss(law.drag, state, dragged)
        return 0


@compiled
def _largest_friction(law: WallFrictionLaw, bed: Bed, i: int, tx: float, ty: float) -> float:
    """Largest friction on a grain at the sides along a direction [F*]."""
    state = bed.state
    normal = _pressing_force(law.sides, law.sides, state.x[i], state.y[i], tx, ty)
    return law.coefficient * value_or_one(relative_moments(bed.constants), i) * normal


@compiled
def _strongest_direction(law: WallFrictionLaw, bed: Bed, i: int) -> tuple[float, float, float]:
    """Direction along which a grain rubs most, and its largest friction there [F*]."""
    tx, ty = law.directions[0]
    hold = _largest_friction(law, bed, i, tx, ty)
    for k in range(1, len(law.directions)):
        other_x, other_y = law.directions[k]
        other = _largest_friction(law, bed, i, other_x, other_y)
        if other > hold:
            tx, ty, hold = other_x, other_y, other
    return tx, ty, hold


@compiled
def _rub_at_other_sides(law: WallFrictionLaw, bed: Bed, i: int, tx: float, ty: float, dt: float) -> float:
    """Slow a grain along all directions but one by friction alone, and return the energy lost [F* D]."""
    state, mass, lost = bed.state, value_or_one(bed.constants.masses, i), 0.0
    for k in range(len(law.directions)):
        x, y = law.directions[k]
        if x == tx and y == ty:
            continue
        v = x * state.vx[i] + y * state.vy[i]
        taken = min(abs(v), dt * _largest_friction(law, bed, i, x, y) / mass)
        state.vx[i] -= math.copysign(taken, v) * x
        state.vy[i] -= math.copysign(taken, v) * y
        lost += 0.5 * mass * taken * (2.0 * abs(v) - taken)
    return lost
