"""Eddy-current drag: a conducting plate brakes a magnet that moves along it.

A dipole mu normal to a thin plate of conductivity s and thickness d, at height h above it, is subject to the
drag force [Reitz 1970, doi:10.1063/1.1659172]

    F = -(3 mu0^2 s d mu^2)/(128 pi h^4) v

at speeds v well below 2/(mu0 s d).

Unlike viscous drag, this drag is proportional to the square of the moment, so grains of different moments
slow down at different rates. The exact solution for a lone grain i of moment q_i and mass m_i, both relative
to the first species, is v exp(-c_i t) with c_i = c_1 q_i^2/m_i.

The eddy currents of moving neighbours also act on a grain: see `granular.effects.mutual_eddy_drag`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.dipole import discs_unless_dipoles
from granular.effects.effect import DissipativeEffect, Effect, EffectContext, recorded_energy_variable
from granular.effects.mutual_eddy_drag import (
    MutualEddyLaw,
    Plate,
    lattice_drag_factor,
    lone_disc_drag_factor,
    make_mutual_eddy_law,
)
from granular.kernel_data.state import LOSSES, Bed, relative_moments
from granular.pairs.direct_sum import pad_values
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import choice_field, flag_field, integer_field, quantity
from granular.shared.array_types import Float

SPACING = 1.375
"""Lattice spacing [D] of the packaged damper at rest, at which the default of `Eddy.mutual` is evaluated."""

TENTH = 0.1


class Eddy(DissipativeEffect):
    """Drag by eddy currents in one or both plates of the cell.

    Attributes
    ----------
    conductivity : float
        Conductivity s of the plates [S/m]; copper has 5.96e7.
    thickness : float
        Thickness d of a plate [m].
    distance : float
        Distance h from the mid-plane of the grains to the mid-plane of a plate [m].
    plates : int
        Number of plates, 1 or 2.
    plate : str
        ``"thin"``: all currents flow in the mid-plane of the plate, as in the formula above; or ``"thick"``:
        they flow throughout the plate. Since nearer parts contribute more, the drag of a plate 2 mm thick at
        a distance of 4 mm is 24 % larger than in the thin-plate formula.
    mutual : bool or None
        Include the eddy currents of the other grains. None: include them if they change the drag of a rigidly
        moving triangular lattice with a spacing of 1.375 D by more than 10 %. The sum over pairs is computed
        four times per step; in large beds it has a cut-off.
    """

    key = "eddy"
    periodic = True
    rank = 1
    example: ClassVar[Any] = {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm"}
    damps = True
    unwritten_defaults = ("plate",)
    loss_record = recorded_energy_variable("eddy_loss", "energy lost to eddy currents")

    conductivity: float = quantity("S/m", least=0.0)
    thickness: float = quantity("m", above=0.0)
    distance: float = quantity("m", above=0.0)
    plates: int = integer_field(default=1, least=1, most=2)
    plate: str = choice_field("thin", "thick", default="thin")
    mutual: bool | None = flag_field(default=None, optional=True)

    def validate(self) -> None:
        """Check that a thick plate does not reach the mid-plane of the grains."""
        if self.plate == "thick" and self.thickness >= 2.0 * self.distance:
            raise FieldError(
                f"a plate {self.thickness:g} m thick, whose mid-plane is {self.distance:g} m from the "
                "grains' mid-plane, reaches the grains' mid-plane; give a thinner plate or a larger "
                "distance",
                "thickness",
            )

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that discs do not reach into the plate."""
        # A thin plate is a sheet at ``distance``, whatever its thickness.
        half = 0.5 * self.thickness if self.plate == "thick" else 0.0
        tallest = 0.5 * float(grains.species_values("thickness").max())
        if grains.magnets == "cylinders" and self.distance <= half + tallest:
            raise FieldError(
                f"{self.distance:g} m must be above {half + tallest:g} m, the distance at which discs "
                "touch the plate; give a larger distance",
                "effects",
                "eddy",
            )

    def _plate_in_natural_units(self, scales: Scales) -> Plate:
        thickness = self.thickness if self.plate == "thick" else 0.0
        return Plate(self.distance / scales.length, thickness / scales.length)

    def includes_mutual_currents(self, count: int, scales: Scales) -> bool:
        """Return True if the eddy currents of other grains are included (see `mutual`)."""
        if self.mutual is not None or count < 2:
            return bool(self.mutual) and count > 1
        return abs(lattice_drag_factor(self._plate_in_natural_units(scales), SPACING) - 1.0) > TENTH

    def dipole_drag_coefficient(self, scales: Scales) -> float:
        """Drag coefficient [kg/s] of a grain of the first species, treated as a dipole between the plates."""
        moment = scales.current * scales.length**2
        sheet = self.plates * self.conductivity * self.thickness
        # Reitz 1970, doi:10.1063/1.1659172.
        strength = 3.0 * scales.permeability**2 * sheet * moment**2
        thin = strength / (128.0 * math.pi * self.distance**4)
        return thin * self._plate_in_natural_units(scales).thickness_drag_factor()

    def decay_rate(self, scales: Scales) -> float:
        """Decay rate of the velocity of a grain of the first species [1/tau]."""
        return self.dipole_drag_coefficient(scales) * scales.time / scales.mass

    def make_kernel_law(self, context: EffectContext) -> EddyLaw | MutualEddyLaw:
        """Make the law for the compiled loop, in natural units."""
        plate, grains = self._plate_in_natural_units(context.scales), context.grains
        rate = self.decay_rate(context.scales)
        discs = discs_unless_dipoles(grains, context.scales.length)
        if self.includes_mutual_currents(grains.count, context.scales):
            return make_mutual_eddy_law(rate / plate.thickness_drag_factor(), plate, discs, context)
        if not discs:
            return EddyLaw(rate, None)
        factors = np.array([lone_disc_drag_factor(plate, disc) for disc in discs])
        return EddyLaw(rate / plate.thickness_drag_factor(), pad_values(factors[context.species]))


class EddyLaw(NamedTuple):
    """Eddy-current drag in natural units, for the compiled loop."""

    rate: float  # [1/tau], of a dipole of the first species
    factors: Float[Array, "m"] | None  # drag of each disc divided by a dipole's; None: dipoles

    @staticmethod
    @compiled(inline=True)
    def damp_velocities(
        law: EddyLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Damp the velocities by the eddy currents; record the lost energy; dt [tau]."""
        state, constants = bed.state, bed.constants
        masses, moments, lost = constants.masses, relative_moments(constants), 0.0
        for i in range(constants.grains):
            mass, moment = value_or_one(masses, i), value_or_one(moments, i)
            rate = law.rate * value_or_one(law.factors, i)
            exponent = -rate * moment * moment / mass * dt
            vx, vy = state.vx[i], state.vy[i]
            lost -= 0.5 * mass * math.expm1(2.0 * exponent) * (vx * vx + vy * vy)
            decay = math.exp(exponent)
            state.vx[i], state.vy[i] = decay * vx, decay * vy
        state.ledger[LOSSES + index] += lost
        return 0
