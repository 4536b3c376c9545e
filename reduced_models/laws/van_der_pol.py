"""The Van der Pol oscillator about an equilibrium (van der Pol 1926).

The damping is negative if the distance from equilibrium is below ``width``, and positive otherwise. The
motion therefore tends to a limit cycle with an amplitude of about twice this width.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    return {
        "mu": omega * np.exp(random.uniform(-3.0, 0.0, count)),
        "rest": guesses.draw_rest_levels(random, count),
        "width": 0.5 * guesses.amplitude * np.exp(random.uniform(-0.3, 0.3, count)),
        "omega": omega,
    }


VAN_DER_POL = Law(
    name="van-der-pol",
    equation="z'' + mu*((z - rest)**2/width**2 - 1)*z' + omega**2*(z - rest) = 0",
    start=_draw_start_values,
    positive=("mu", "width", "omega"),
    units={"mu": "1/s", "rest": "m", "width": "m", "omega": "rad/s"},
    source="B. van der Pol 1926, doi:10.1080/14786442608564127",
)
