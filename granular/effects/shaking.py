"""Shaking of the cell: an oscillating inertial force in the frame of the cell.

The cell moves as X sin(2 pi f t) along a direction. In the frame of the cell, every mass m at r has the
additional acceleration A(t) = X (2 pi f)^2 sin(2 pi f t) along this direction, and the time-dependent
potential energy -m A(t) . r. The partial time derivative of this energy is the power of the shaker. Drag and
friction act on the velocity relative to the cell.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

from granular.compiled import Array, compiled
from granular.effects.effect import EffectContext, GrainsAndPistonEffect, recorded_energy_variable
from granular.kernel_data.state import HEIGHT, WORK, Bed
from granular.pairs.grain_arrays import value_or_one
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity
from granular.shared.array_types import Float


class Shaking(GrainsAndPistonEffect):
    """Sinusoidal motion of the whole cell.

    Attributes
    ----------
    amplitude : float
        Amplitude X of the displacement [m].
    frequency : float
        Frequency f [Hz].
    angle : float
        Direction of the motion, from the horizontal [rad]; vertical by default.
    """

    key = "shaking"
    example: ClassVar[Any] = {"amplitude": "0.5 mm", "frequency": "20 Hz", "angle": 1.0}
    energy_record = recorded_energy_variable("weight_energy", "potential energy of the weight")

    amplitude: float = quantity("m", least=0.0)
    frequency: float = quantity("Hz", above=0.0)
    angle: float = quantity("1", default=math.pi / 2.0)

    def maximum_imparted_speed(self, scales: Scales) -> float:
        """Maximum speed of the cell [D/tau]."""
        law = self._acceleration_in_natural_units(scales)
        return math.hypot(law.x, law.y) / law.omega

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Angular frequency of the motion [1/tau]."""
        return self._acceleration_in_natural_units(scales).omega

    def make_kernel_law(self, context: EffectContext) -> ShakingLaw:
        """Make the inertial acceleration for the compiled loop, in natural units."""
        return self._acceleration_in_natural_units(context.scales)

    def _acceleration_in_natural_units(self, scales: Scales) -> ShakingLaw:
        omega = 2.0 * math.pi * self.frequency * scales.time
        size = self.amplitude / scales.length * omega**2
        return ShakingLaw(size * math.cos(self.angle), size * math.sin(self.angle), omega)


class ShakingLaw(NamedTuple):
    """Inertial acceleration (x, y) sin(omega t), in natural units."""

    x: float  # [D/tau^2]
    y: float  # [D/tau^2]
    omega: float  # [1/tau]

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: ShakingLaw, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the inertial forces m A(t) on the grains [F*]; time [tau]."""
        state, constants, phase = bed.state, bed.constants, math.sin(law.omega * time)
        ax, ay = law.x * phase, law.y * phase
        for i in range(constants.grains):
            mass = value_or_one(constants.masses, i)
            state.fx[i] += mass * ax
            state.fy[i] += mass * ay
        return 0

    @staticmethod
    @compiled(inline=True)
    def measure_energy_and_stiffness(
        law: ShakingLaw,
        workspace: None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the potential energy [F* D]: the sum of -m A(t) . r over the grains; time [tau]."""
        phase = math.sin(law.omega * time)
        ax, ay = law.x * phase, law.y * phase
        mx, my = _sum_of_mass_times_position(bed)
        energies[index] = -(ax * mx + ay * my)
        return 0

    @staticmethod
    @compiled(inline=True)
    def record_external_work(
        law: ShakingLaw, workspace: None, index: int, dt: float, bed: Bed, time: float
    ) -> int:
        """Record the work of the shaking on grains and piston in ``dt`` [F* D]; dt, time [tau]."""
        state, constants = bed.state, bed.constants
        # The external power is the rate of change of the energy -m A(t) . r at fixed positions, -m A'(t) . r.
        phase = law.omega * math.cos(law.omega * time)
        rx, ry = law.x * phase, law.y * phase
        mx, my = _sum_of_mass_times_position(bed)
        state.ledger[WORK] -= dt * (rx * mx + ry * my)
        if constants.piston_mass < math.inf:
            state.ledger[WORK] -= dt * ry * constants.piston_mass * state.piston[HEIGHT]
        return 0

    @staticmethod
    @compiled(inline=True)
    def upward_acceleration(law: ShakingLaw, workspace: None, index: int, time: float) -> float:
        """Upward component of the inertial acceleration [D/tau^2]; time [tau]."""
        return law.y * math.sin(law.omega * time)


@compiled
def _sum_of_mass_times_position(bed: Bed) -> tuple[float, float]:
    """Sum of m x and sum of m y over the grains."""
    state, constants, total_x, total_y = bed.state, bed.constants, 0.0, 0.0
    for i in range(constants.grains):
        mass = value_or_one(constants.masses, i)
        total_x += mass * state.x[i]
        total_y += mass * state.y[i]
    return total_x, total_y
