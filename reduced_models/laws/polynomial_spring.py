"""A cubic polynomial spring about equilibrium, with viscous drag."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    k1 = guesses.draw_frequencies(random, count) ** 2
    return {
        "lam": guesses.draw_decay_rates(random, count),
        "k1": k1,
        "rest": guesses.draw_rest_levels(random, count),
        "k2": k1 / guesses.amplitude * random.uniform(-0.3, 0.3, count),
        "k3": k1 / guesses.amplitude**2 * random.uniform(-0.2, 0.5, count),
    }


POLYNOMIAL_SPRING = Law(
    name="polynomial-spring",
    equation="z'' + 2*lam*z' + k1*(z - rest) + k2*(z - rest)**2 + k3*(z - rest)**3 = 0",
    start=_draw_start_values,
    positive=("lam", "k1"),
    units={"lam": "1/s", "k1": "1/s^2", "rest": "m", "k2": "1/(m s^2)", "k3": "1/(m^2 s^2)"},
    source="Taylor series of the force about rest",
)
