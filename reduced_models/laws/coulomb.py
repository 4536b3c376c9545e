"""A linear spring with dry friction (Coulomb 1785), in a smooth form without events.

The friction is full beyond some hundredths of the speed friction/omega, below which it falls
smoothly to zero: z'' + friction tanh(S omega z'/friction) + omega^2 z = g0, S = 20. The amplitude
falls by 4 friction/omega^2 a period, in a straight line. Where a piston would stick, this one
creeps back to the level of rest, at the rate omega/S at most.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    omega = guesses.frequencies(random, count)
    # A swing of amplitude A loses as much in a period as by 2 lam v where
    # lam = 2 friction/(pi omega A).
    size = 0.5 * np.pi * guesses.frequency * guesses.amplitude
    return {
        "friction": guesses.decays(random, count) * size,
        "omega": omega,
        "g0": omega**2 * guesses.levels(random, count),
    }


COULOMB = Law(
    name="coulomb",
    equation="z'' + friction*tanh(20*omega*z'/friction) + omega**2*z = g0",
    start=_start,
    positive=("friction", "omega"),
    units={"friction": "m/s^2", "omega": "rad/s", "g0": "m/s^2"},
    source="C. A. Coulomb 1785, with tanh for the sign of the speed",
    resolution=4,
)
