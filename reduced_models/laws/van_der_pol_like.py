"""The source's Van der Pol-like law [D, eq. 5.12].

z'' + 2 alpha (z^2 - 2 z) z' + omega^2 z = g0. The damping 2 alpha ((z - 1)^2 - 1) is a parabola
about z = 1, so the law takes another form when the height is shifted or scaled: it holds for
z = (height - shift)/scale. Two things are fixed by convention, since no record can tell them: the
time unit is 1 s, and the scale is positive (the law turns into itself under z -> 2 - z).

Where a motion is so small that the damping hardly changes in its course, only the damping at rest
can be known, and alpha, shift and scale are tied to each other: the fit names that direction.
"""

from __future__ import annotations

import numpy as np

from reduced_models.estimates import Estimates
from reduced_models.law import Law


def _start(estimates: Estimates, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    omega = estimates.frequency * np.exp(random.uniform(-0.15, 0.15, count))
    level = estimates.rest + estimates.amplitude * random.uniform(-0.1, 0.1, count)
    # Twice the decay is the damping 2 alpha ((level - 1)^2 - 1), where that is positive.
    shape = np.maximum(np.abs((level - 1.0) ** 2 - 1.0), 0.1)
    alpha = estimates.decay / shape * np.exp(random.uniform(-1.5, 1.5, count))
    return {"alpha": alpha, "omega": omega, "g0": omega**2 * level}


VAN_DER_POL_LIKE = Law(
    name="van-der-pol-like",
    equation="z'' + 2*alpha*(z**2 - 2*z)*z' + omega**2*z = g0",
    start=_start,
    positive=("alpha", "omega"),
    units={"alpha": "1/s", "omega": "rad/s", "g0": "1/s^2"},
    mapped=True,
    source="[D, eq. 5.12]",
)
