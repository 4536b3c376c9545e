"""A linear spring with drag proportional to the square of the speed; also with viscous drag."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.laws.linear import split_damping_at_random
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    # At amplitude A the drag c |v| v dissipates as much energy as the viscous drag 2 lam v with
    # lam = 4/(3 pi) c omega A.
    size = 3.0 * np.pi / (4.0 * guesses.frequency * guesses.amplitude)
    return {
        "c": guesses.draw_decay_rates(random, count) * size,
        "omega": omega,
        "g0": omega**2 * guesses.draw_rest_levels(random, count),
    }


QUADRATIC_DRAG = Law(
    name="quadratic-drag",
    equation="z'' + c*Abs(z')*z' + omega**2*z = g0",
    start=_draw_start_values,
    positive=("c", "omega"),
    units={"c": "1/m", "omega": "rad/s", "g0": "m/s^2"},
    source="drag proportional to the square of the speed (Newton 1687)",
)


def _draw_start_values_with_drag(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    return split_damping_at_random(_draw_start_values(guesses, random, count), "c", guesses, random)


VISCOUS_QUADRATIC = Law(
    name="viscous-quadratic",
    equation="z'' + 2*lam*z' + c*Abs(z')*z' + omega**2*z = g0",
    start=_draw_start_values_with_drag,
    positive=("omega",),
    units={"lam": "1/s", **QUADRATIC_DRAG.units},
    source="linear (Stokes) and quadratic (Newton) drag together",
)
