"""Two linear modes observed in one column: the law that `identify --coordinates 2` fits to a free decay."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.second_mode import fit_two_modes

_SPREAD = 0.05  # spread of the logarithms of start values


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    modes = fit_two_modes(guesses.time, guesses.heights)
    root = complex(-modes.decay_rates[1], modes.frequencies[1])
    values = {
        "rest": modes.level,
        "y": modes.amplitudes[1].real,
        "y_first": (root * modes.amplitudes[1]).real,
    }
    names = (("lam", "omega"), ("mu", "nu"))
    for pair, decay, signed in zip(names, modes.decay_rates, modes.frequencies, strict=True):
        frequency = abs(signed)
        values |= dict(
            zip(pair, (max(decay, 1e-3 * frequency), float(np.hypot(frequency, decay))), strict=True)
        )
    # The first start value is the fit of two damped cosines itself.
    spread = _SPREAD * (np.arange(count) > 0)
    return {name: value * np.exp(spread * random.normal(size=count)) for name, value in values.items()}


TWO_MODES = Law(
    name="two-modes",
    equation=(
        "z'' + 2*lam*(z' - y') + omega**2*(z - y - rest) + 2*mu*y' + nu**2*y = 0; "
        "y'' + 2*mu*y' + nu**2*y = 0; height = z"
    ),
    start=_draw_start_values,
    positive=("lam", "omega", "mu", "nu"),
    units={"lam": "1/s", "omega": "rad/s", "rest": "m", "mu": "1/s", "nu": "rad/s"},
    source="modal superposition of two damped oscillators; y is the displacement of the second mode",
)
