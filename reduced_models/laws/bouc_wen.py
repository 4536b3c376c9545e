"""Normalised Bouc-Wen hysteresis, with a linear spring and viscous drag.

The hysteretic force is ``friction`` times a hidden state w, which starts at zero and tends to +-1:
w' = rho (z' - sigma |z'| |w|^(n-1) w + (sigma - 1) z' |w|^n), with n = 2, so that the transition to
full force is smooth. The force builds up over the travel 1/rho. For sigma above 1/2 every cycle dissipates
energy.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    size = 0.5 * np.pi * guesses.frequency * guesses.amplitude
    return {
        "omega": omega * np.exp(random.uniform(-0.2, 0.0, count)),
        "friction": guesses.draw_decay_rates(random, count) * size,
        "rho": np.exp(random.uniform(-1.0, 2.0, count)) / guesses.amplitude,
        "sigma": np.exp(random.uniform(-0.7, 1.0, count)),
        "g0": omega**2 * guesses.draw_rest_levels(random, count),
    }


BOUC_WEN = Law(
    name="bouc-wen",
    equation=(
        "z'' + omega**2*z + friction*w = g0; w' = rho*(z' - sigma*Abs(z')*Abs(w)*w + (sigma - 1)*z'*w**2)"
    ),
    start=_draw_start_values,
    positive=("omega", "friction", "rho", "sigma"),
    units={"omega": "rad/s", "friction": "m/s^2", "rho": "1/m", "sigma": "1", "g0": "m/s^2"},
    source="F. Ikhouane, J. Rodellar 2005, doi:10.1007/s11071-005-0069-3",
    resolution=2,
)
