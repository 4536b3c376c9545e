"""The linear damped oscillator (de Paula 2025, [D, eq. 5.11])."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    return {
        "lam": guesses.draw_decay_rates(random, count),
        "omega": omega,
        "g0": omega**2 * guesses.draw_rest_levels(random, count),
    }


def split_damping_at_random(
    values: dict[str, np.ndarray], name: str, guesses: FirstGuesses, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Split the damping [1/s] of start values at random into the parameter ``name`` and a viscous drag."""
    count = len(values[name])
    fraction = random.uniform(size=count)
    remaining, viscous = values[name] * fraction, guesses.draw_decay_rates(random, count) * (1.0 - fraction)
    return {**values, name: remaining, "lam": viscous}


LINEAR = Law(
    name="linear",
    equation="z'' + 2*lam*z' + omega**2*z = g0",
    start=_draw_start_values,
    positive=("lam", "omega"),
    units={"lam": "1/s", "omega": "rad/s", "g0": "m/s^2"},
    source="[D, eq. 5.11]",
)
