"""Dry sliding friction of the grains at the side walls.

A grain that a side wall pushes with the force N rubs along it with at most mu N, against its motion
along the wall (Coulomb; Popov, Contact Mechanics and Friction (2010), 10). N is the wall's own
magnetic force on the grain. Along a wall the motion is one-dimensional, and under constant force,
drag and friction it is solved exactly: a grain that slides stops and stays, to the last bit, while
the force along the wall is at most mu N.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.effects.dissipative_effect import DissipativeEffect
from granular.effects.effect import Effect, EffectContext, energy_variable
from granular.effects.slide import drag_flow_coefficients, move_with_drag, slide
from granular.effects.wall_side import force_at_distance
from granular.kernel_data.constants import relative_moments
from granular.kernel_data.state import LOSSES, Bed
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Cell, Grains, Piston
from granular.schema.field_kinds import FieldError
from granular.schema.sections import quantity

if TYPE_CHECKING:
    from jaxtyping import Float

_SIDES = ("left", "right")


class WallFriction(DissipativeEffect):
    """Coulomb friction at the left and the right wall.

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
        sides = [] if walls is None else [getattr(walls, side) for side in _SIDES]
        if not any(sides):
            raise FieldError("there is no side wall to rub at; give effects.walls", "effects", self.key)
        if any(side is not None and side.law in ("slab", "discs") for side in sides):
            raise FieldError(
                "slabs and discs have no law of the distance alone; take 'infinite'", "effects", self.key
            )

    def make_kernel_law(self, context: EffectContext) -> WallFrictionLaw:
        """Make the law that the compiled loop takes; it takes the drag along."""
        walls = context.effects["walls"]
        left, right = (
            None if side is None else side.make_kernel_law(context) for side in (walls.left, walls.right)
        )
        return WallFrictionLaw(self.coefficient, left, right, *drag.drag_taken_along(context))


class WallFrictionLaw(NamedTuple):
    """Friction at the side walls as the kernels take it."""

    coefficient: float
    left: Any
    right: Any
    kind: Float[Array, "m"] | None  # of the drag that is solved along, as in `DragLaw`
    rates: drag.DragRateTable
    drag: int | None  # index in the ledger of the loss to drag

    @staticmethod
    @compiled
    def kick(law: WallFrictionLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        """Kick the grains by force, drag and wall friction, together and exactly; dt [tau]."""
        state, constants = bed.state, bed.constants
        masses, moments = constants.masses, relative_moments(constants)
        rubbed, dragged = 0.0, 0.0
        for k in range(len(law.rates.values)):
            rate = law.rates.values[k]
            flow = drag_flow_coefficients(rate, dt)
            for i in range(constants.grains):
                if not drag.is_of_drag_kind(law.kind, i, k):
                    continue
                mass, x = value_or_one(masses, i), state.x[i]
                normal = force_at_distance(law.left, x) + force_at_distance(law.right, constants.width - x)
                hold = law.coefficient * value_or_one(moments, i) * normal
                state.vx[i], _, lost = move_with_drag(flow, state.vx[i], 0.0, state.fx[i] / mass, 0.0)
                dragged += mass * lost
                along, force = (0.0, state.vy[i]), (0.0, state.fy[i])
                _, state.vy[i], by_drag, by_friction = slide(
                    rate, dt, flow, mass, along, force, 1.0, 1.0, hold
                )
                rubbed += by_friction
                dragged += by_drag
        state.ledger[LOSSES + index] += rubbed
        drag.record_drag_loss(law.drag, state, dragged)
        return 0
