"""A linear spring with dry friction (Coulomb 1785), smoothed in the speed; also with viscous drag.

The equation is z'' + friction tanh(S omega z'/friction) + omega^2 z = g0 with S = 20. The friction has nearly
its full value above a tenth of the speed friction/omega; below this speed it decreases smoothly to zero, so
no event detection is needed. The amplitude decays linearly in time, by 4 friction/omega^2 per period. A real
piston would stick; in this law it creeps back to equilibrium, at a rate of omega/S or less.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.laws.linear import split_damping_at_random
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    # At amplitude A the energy loss per period equals that of viscous drag 2 lam v with
    # lam = 2 friction/(pi omega A).
    size = 0.5 * np.pi * guesses.frequency * guesses.amplitude
    return {
        "friction": guesses.draw_decay_rates(random, count) * size,
        "omega": omega,
        "g0": omega**2 * guesses.draw_rest_levels(random, count),
    }


COULOMB = Law(
    name="coulomb",
    equation="z'' + friction*tanh(20*omega*z'/friction) + omega**2*z = g0",
    start=_draw_start_values,
    positive=("friction", "omega"),
    units={"friction": "m/s^2", "omega": "rad/s", "g0": "m/s^2"},
    source="C. A. Coulomb 1785, with tanh for the sign of the speed",
    resolution=4,
)


def _draw_start_values_with_drag(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    return split_damping_at_random(_draw_start_values(guesses, random, count), "friction", guesses, random)


VISCOUS_COULOMB = Law(
    name="viscous-coulomb",
    equation="z'' + 2*lam*z' + friction*tanh(20*omega*z'/friction) + omega**2*z = g0",
    start=_draw_start_values_with_drag,
    positive=("friction", "omega"),
    units={"lam": "1/s", **COULOMB.units},
    source=COULOMB.source,
    resolution=COULOMB.resolution,
)
