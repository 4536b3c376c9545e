"""A force: it has an energy, and is minus its gradient. `granular.effects.gravity` is a short one.

Hooks of its law, behind ``law, workspace, index``:

``add_forces(..., bed, time) -> int``
    Add the forces on the grains; how many grains are where they cannot be.
``measure_energy_and_stiffness(..., bed, time, stiffness, energies) -> int``
    Enter the energy at ``energies[index]``; add to ``stiffness`` a bound of each grain's stiffness
    over its mass, which the automatic step follows.
``record_external_work(..., dt, bed, time) -> int``
    Enter in ``state.ledger[WORK]`` what a force that depends on time does.
``squared_head_on_impact_frequency(..., speed, constants) -> float``
    Greatest stiffness over mass that a grain of this speed meets.
"""

from __future__ import annotations

from granular.effects.effect import Effect
from granular.schema.natural_units import Scales

HOOKS = (
    "add_forces",
    "measure_energy_and_stiffness",
    "record_external_work",
    "squared_head_on_impact_frequency",
)


class ForceEffect(Effect):
    """Base of the effects that have an energy."""

    def downward_acceleration(self, scales: Scales) -> float:
        """Downward acceleration that never changes, which can make grains faster.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [D/tau^2]; 0 where the effect has none.
        """
        return 0.0
