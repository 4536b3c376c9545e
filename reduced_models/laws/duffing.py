"""The Duffing oscillator: a linear spring with a cubic term (Duffing 1918).

If the linear stiffness is negative, ``rest`` is the barrier between two potential wells, and the
motion crosses the barrier or stays in one well.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses

# Fractions of the start values with motion across both wells, and within one.
_ACROSS_FRACTION, _WITHIN_FRACTION = 0.2, 0.1
_MINIMUM_STARTS = 4  # minimum number of starts for one of each kind


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    k = guesses.draw_frequencies(random, count) ** 2
    result = {
        "lam": guesses.draw_decay_rates(random, count),
        "k": k,
        "rest": guesses.draw_rest_levels(random, count),
        "beta": k / guesses.amplitude**2 * random.uniform(-0.2, 0.5, count),
    }
    return _move_last_start_to_two_wells(result, guesses, random)


def _move_last_start_to_two_wells(
    result: dict[str, np.ndarray], guesses: FirstGuesses, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Replace the last start values by values for negative linear stiffness (two potential wells)."""
    count = len(result["k"])
    minimum = int(count >= _MINIMUM_STARTS)
    across, within = (
        max(minimum, round(fraction * count)) for fraction in (_ACROSS_FRACTION, _WITHIN_FRACTION)
    )
    wide, narrow = slice(count - across, None), slice(count - across - within, count - across)
    square = result["k"].copy()  # square of the observed angular frequency
    # Across both wells k + 3/4 beta a^2 equals that square, by harmonic balance.
    result["k"][wide] = -square[wide] * random.uniform(0.0, 0.5, across)
    result["beta"][wide] = (square - result["k"])[wide] / (0.75 * guesses.amplitude**2)
    # A well is at sqrt(-k/beta) from the barrier, and its stiffness is -2 k.
    well_distance = guesses.amplitude * random.uniform(1.0, 2.0, within)
    result["k"][narrow] = -0.5 * square[narrow]
    result["beta"][narrow] = 0.5 * square[narrow] / well_distance**2
    result["rest"][narrow] += np.where(random.uniform(size=within) < 0.5, -1.0, 1.0) * well_distance
    return result


DUFFING = Law(
    name="duffing",
    equation="z'' + 2*lam*z' + k*(z - rest) + beta*(z - rest)**3 = 0",
    start=_draw_start_values,
    positive=("lam",),
    units={"lam": "1/s", "k": "1/s^2", "rest": "m", "beta": "1/(m^2 s^2)"},
    source="G. Duffing 1918; I. Kovacic, M. J. Brennan, doi:10.1002/9780470977859",
)
