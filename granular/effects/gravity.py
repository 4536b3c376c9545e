"""Weight of the grains, and of a piston that has a mass and is free."""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.scene.scales import Scales
from granular.scene.schema import Section, quantity


class Gravity(Section):
    """Uniform gravity, downwards.

    Attributes
    ----------
    acceleration : float
        g [m/s^2]; 9.8 is the source's value [D, Table 4.3].
    """

    acceleration: float = quantity("m/s^2", default=9.8, least=0.0)

    def kernel(self, scales: Scales) -> float:
        """G = m g / F*, the acceleration in natural units."""
        return self.acceleration / scales.acceleration


@compiled(inline=True)
def add_weight(gravity: float | None, count: int, masses: Array | None, fy: Array) -> None:
    """Add the grains' weight, -G times the mass."""
    if gravity is not None:
        if masses is None:
            for i in range(count):
                fy[i] -= gravity
        else:
            for i in range(count):
                fy[i] -= gravity * masses[i]


@compiled
def weight_energy(gravity: float | None, count: int, masses: Array | None, y: Array) -> float:
    """Sum of m g y over the grains [F* D], zero at the bottom."""
    total = 0.0
    if gravity is not None:
        for i in range(count):
            mass = 1.0
            if masses is not None:
                mass = masses[i]
            total += gravity * mass * y[i]
    return total
