"""The linear damped oscillator [D, eq. 5.11]."""

from __future__ import annotations

import numpy as np

from reduced_models.estimates import Estimates
from reduced_models.law import Law


def _start(estimates: Estimates, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    omega = estimates.frequency * np.exp(random.uniform(-0.15, 0.15, count))
    return {
        "lam": estimates.decay * np.exp(random.uniform(-1.5, 1.5, count)),
        "omega": omega,
        "g0": omega**2 * (estimates.rest + estimates.amplitude * random.uniform(-0.1, 0.1, count)),
    }


LINEAR = Law(
    name="linear",
    equation="z'' + 2*lam*z' + omega**2*z = g0",
    start=_start,
    positive=("lam", "omega"),
    units={"lam": "1/s", "omega": "rad/s", "g0": "m/s^2"},
    source="[D, eq. 5.11]",
)
