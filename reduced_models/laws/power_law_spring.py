"""A spring that carries a weight, with a force that is a power of the height, and viscous drag.

A bed that rearranges while it is compressed between walls carries a piston with a force that is nearly
proportional to height^-2.5; in this law the exponent is free. The force is written relative to the weight of
the piston; force and weight are equal at the equilibrium height.

The law holds for a column that is compressed affinely: N grains, each with drag coefficient gamma, follow a
piston of mass M. A grain at the fraction s of the height z has the velocity s z'. The drag of all grains
dissipates the power N gamma z'^2 times the mean of s^2, which is 1/3, so 2 lam = N gamma/(3 M). For grains
that repel like dipoles, power = 5/2 and weight = g.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    # The law holds for heights above the floor; a record about zero needs another law.
    rest = np.maximum(np.abs(guesses.draw_rest_levels(random, count)), guesses.amplitude)
    power = np.exp(random.uniform(0.0, 2.0, count))
    return {
        "lam": guesses.draw_decay_rates(random, count),
        "weight": omega**2 * rest / power,
        "rest": rest,
        "power": power,
    }


POWER_LAW_SPRING = Law(
    name="power-law-spring",
    equation="z'' + 2*lam*z' = weight*((rest/z)**power - 1)",
    start=_draw_start_values,
    positive=("lam", "weight", "rest", "power"),
    units={"lam": "1/s", "weight": "m/s^2", "rest": "m", "power": "1"},
    source="force of a bed that rearranges, close to height^-2.5",
)
