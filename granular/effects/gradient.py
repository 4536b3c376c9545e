"""The gradient of an external magnetic field, which pulls at moments normal to the plane.

A dipole mu along z in a field B_z = g_x x + g_y y has the energy -mu B_z and feels the force
mu (g_x, g_y) [Jackson, Classical Electrodynamics (1999), 5.7]. A uniform field does nothing.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

from granular.compiled import Array, compiled
from granular.effects.effect import Effect, Setting, in_joules
from granular.kernel_data.constants import Constants, moments_of, value_of
from granular.kernel_data.state import State
from granular.schema.sections import quantity


class Gradient(Effect):
    """A uniform gradient of the field along the moments.

    Attributes
    ----------
    x, y : float
        g_x and g_y [T/m]: where they are positive, grains are pulled right and up.
    """

    key = "gradient"
    example: ClassVar[Any] = {"x": "0.05 T/m", "y": "-0.1 T/m"}
    energy_record = in_joules("gradient_energy", "energy in the external field")

    x: float = quantity("T/m", default=0.0)
    y: float = quantity("T/m", default=0.0)

    def law(self, setting: Setting) -> GradientLaw:
        """The law in natural units."""
        unit = setting.scales.unit("T/m")
        return GradientLaw(self.x / unit, self.y / unit)


class GradientLaw(NamedTuple):
    """Force on a grain of moment 1 [F*]."""

    x: float
    y: float

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: GradientLaw, room: None, place: int, state: State, constants: Constants, time: float
    ) -> int:
        """Add the forces."""
        moments = moments_of(constants)
        for i in range(constants.grains):
            moment = value_of(moments, i)
            state.fx[i] += moment * law.x
            state.fy[i] += moment * law.y
        return 0

    @staticmethod
    @compiled
    def measure(
        law: GradientLaw, room: None, place: int, state: State, constants: Constants, time: float,
        stiffness: Array, energies: Array,
    ) -> int:  # fmt: skip
        """Enter the energy."""
        moments, total = moments_of(constants), 0.0
        for i in range(constants.grains):
            total -= value_of(moments, i) * (law.x * state.x[i] + law.y * state.y[i])
        energies[place] = total
        return 0
