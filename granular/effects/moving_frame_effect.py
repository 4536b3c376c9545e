"""A frame: it acts on everything, the piston too. `granular.effects.shaking` is a short one.

A host moves grains and piston by their forces, so the loop itself moves it: `granular.engine.bodies`.
Hooks of its law, behind ``law, workspace, index``, next to those of a force that it may have:

``upward_acceleration(..., time) -> float``
    Upward acceleration of all that has a mass.
``drift(..., dt, bed) -> int``
    Positions after ``dt``, instead of the plain drift, and velocities that change in its middle, as
    a heat bath wants it; for Störmer-Verlet's coefficients alone.
"""

from __future__ import annotations

from granular.effects.effect import Effect
from granular.schema.natural_units import Scales

HOOKS = ("upward_acceleration", "drift")


class MovingFrameEffect(Effect):
    """Base of the effects that carry grains and piston together."""

    def greatest_imparted_speed(self, scales: Scales) -> float:
        """Greatest speed that the effect lends to all grains.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [D/tau]; 0 where it lends none.
        """
        return 0.0
