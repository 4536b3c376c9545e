"""A flow: it takes energy, and is solved exactly. `granular.effects.eddy_drag` is a short one.

Its velocities after a duration are exact at fixed positions: as a force it would cost the second
order. What it takes is entered in ``state.ledger[LOSSES + index]``. Hooks of its law, behind
``law, workspace, index``:

``damp_velocities(..., dt, bed, opens_step) -> int``
    Velocities after ``dt`` under this effect alone; forward behind the kick that opens a step,
    backward before the one that closes it.
``kick(..., dt, bed, opens_step) -> int``
    Velocities after ``dt`` under all forces, instead of the plain kick, for what must be solved
    together with them; the last effect that has one gives it, and must take along what others do.
"""

from __future__ import annotations

from granular.effects.effect import Effect
from granular.schema.natural_units import Scales

HOOKS = ("damp_velocities", "kick")


class DissipativeEffect(Effect):
    """Base of the effects that take energy."""

    def decay_rate(self, scales: Scales) -> float:
        """Rate of a linear decay of the velocities, which a step is to resolve up to a limit.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [1/tau]; 0 where the effect has none.
        """
        return 0.0
