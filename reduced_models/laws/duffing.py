"""The Duffing oscillator: a linear spring with a cubic term (Duffing 1918)."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    omega = guesses.frequencies(random, count)
    return {
        "lam": guesses.decays(random, count),
        "omega": omega,
        "rest": guesses.levels(random, count),
        "beta": (omega / guesses.amplitude) ** 2 * random.uniform(-0.2, 0.5, count),
    }


DUFFING = Law(
    name="duffing",
    equation="z'' + 2*lam*z' + omega**2*(z - rest) + beta*(z - rest)**3 = 0",
    start=_start,
    positive=("lam", "omega"),
    units={"lam": "1/s", "omega": "rad/s", "rest": "m", "beta": "1/(m^2 s^2)"},
    source="G. Duffing 1918; I. Kovacic, M. J. Brennan, doi:10.1002/9780470977859",
)
