"""Weight of the grains, and of a free piston with a mass."""

from __future__ import annotations

from typing import Any, NamedTuple

from granular.compiled import Array, compiled
from granular.effects.effect import EffectContext, ForceEffect, recorded_energy_variable
from granular.kernel_data.state import Bed
from granular.pairs.grain_arrays import value_or_one
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity
from granular.shared.array_types import Float


class Gravity(ForceEffect):
    """Uniform gravity: downwards, or towards the piston if a host carries the piston below the cell.

    Attributes
    ----------
    acceleration : float
        Acceleration g [m/s^2]; 9.8 is de Paula's value [D, Table 4.3].
    """

    key = "gravity"
    energy_record = recorded_energy_variable("weight_energy", "potential energy of the weight")

    acceleration: float = quantity("m/s^2", default=9.8, least=0.0)

    def downward_acceleration(self, scales: Scales) -> float:
        """Acceleration in natural units, G = m g/F* [D/tau^2]."""
        return self.acceleration / scales.acceleration

    def make_kernel_law(self, context: EffectContext) -> GravityLaw:
        """Make the law for the compiled loop, in natural units."""
        host: Any = context.effects.get("host")
        upside_down = host is not None and host.mount == "piston"
        pull = self.downward_acceleration(context.scales)
        return GravityLaw(-pull if upside_down else pull)


class GravityLaw(NamedTuple):
    """Gravity in natural units, for the compiled loop."""

    pull: float  # G [F*/m]

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: GravityLaw, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the grains' weight, -G times the mass [F*]; time [tau]."""
        state, constants = bed.state, bed.constants
        for i in range(constants.grains):
            state.fy[i] -= law.pull * value_or_one(constants.masses, i)
        return 0

    @staticmethod
    @compiled(inline=True)
    def measure_energy_and_stiffness(
        law: GravityLaw,
        workspace: None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the potential energy [F* D]: the sum of m g y over the grains, with y = 0 at the bottom."""
        state, constants, total = bed.state, bed.constants, 0.0
        for i in range(constants.grains):
            total += law.pull * value_or_one(constants.masses, i) * state.y[i]
        energies[index] = total
        return 0
