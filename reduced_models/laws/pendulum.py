"""A pendulum with viscous drag and either dry friction or quadratic drag.

The coordinate z is the angle [rad]; in equilibrium the pendulum hangs straight down.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.coulomb import VISCOUS_COULOMB
from reduced_models.laws.law import Law, Starts
from reduced_models.laws.quadratic_drag import VISCOUS_QUADRATIC
from reduced_models.records.first_guesses import FirstGuesses


def _law_with_pendulum_torque(law: Law) -> Law:
    """Replace the linear spring of a law by the restoring torque of a pendulum."""
    assert law.start is not None
    linear: Starts = law.start

    def draw_start_values(
        guesses: FirstGuesses, random: np.random.Generator, count: int
    ) -> dict[str, np.ndarray]:
        values = linear(guesses, random, count)
        values["rest"] = values.pop("g0") / values["omega"] ** 2
        return values

    units = {name: unit.replace("m/s", "rad/s") for name, unit in law.units.items()}
    del units["g0"]
    return Law(
        name=law.name.replace("viscous", "pendulum"),
        equation=law.equation.replace("omega**2*z = g0", "omega**2*sin(z - rest) = 0"),
        start=draw_start_values,
        positive=law.positive,
        units={**units, "rest": "rad"},
        source="C. Huygens 1673",
        resolution=law.resolution,
    )


PENDULUM_COULOMB = _law_with_pendulum_torque(VISCOUS_COULOMB)
PENDULUM_QUADRATIC = _law_with_pendulum_torque(VISCOUS_QUADRATIC)
