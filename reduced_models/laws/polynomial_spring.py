"""A cubic polynomial spring about equilibrium, with viscous drag."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.duffing import DUFFING
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    # Start values of the Duffing oscillator, which the law contains; half of them are left unchanged.
    assert DUFFING.start is not None
    start = DUFFING.start(guesses, random, count)
    k1, k3 = start.pop("k"), start.pop("beta")
    slope = np.abs(k1) / guesses.amplitude * random.uniform(-0.3, 0.3, count)
    return {**start, "k1": k1, "k2": slope * (np.arange(count) % 2 == 1), "k3": k3}


POLYNOMIAL_SPRING = Law(
    name="polynomial-spring",
    equation="z'' + 2*lam*z' + k1*(z - rest) + k2*(z - rest)**2 + k3*(z - rest)**3 = 0",
    start=_draw_start_values,
    positive=("lam",),
    units={"lam": "1/s", "k1": "1/s^2", "rest": "m", "k2": "1/(m s^2)", "k3": "1/(m^2 s^2)"},
    source="Taylor series of the force about rest",
)
