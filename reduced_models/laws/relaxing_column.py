"""A column of grains that lags behind its piston: a drag force with one relaxation time.

In the power-law spring the grains of a column follow the piston affinely. In fact drag delays them: in a
column of N grains with drag coefficient gamma and stiffness k at the piston, the displacement diffuses. Let
the bottom be fixed, and let the top oscillate at the angular frequency omega. With s = i omega N gamma/k, the
ratio of the stiffness to its static value is f(s) = sqrt(s) coth sqrt(s) = 1 + s/3 - s^2/45 + ... A
single mode that matches the terms in s and s^2 is

    f(s) = 1 + (s/3)/(1 + s/15).

Its second term is the affine drag, a third of the drag of all grains, which follows the speed with the
time constant N gamma/(15 k). In the law of motion the drag is 2 lam w, where the speed w of the
grains lags behind the speed of the piston,

    w' = (z' - w)/relaxation.

For a known scene lam = N gamma/(6 M), power = 5/2, weight = g and, since k is power M g/rest, relaxation = 2
lam rest/(5 power g). In the packaged damper the relaxation time is one millisecond; it is assumed to be the
same at all heights. If it tends to zero, the law becomes the power-law spring.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.laws.power_law_spring import POWER_LAW_SPRING
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    assert POWER_LAW_SPRING.start is not None
    known = POWER_LAW_SPRING.start(guesses, random, count)
    # From a hundredth of 1/omega on: with a shorter relaxation the drag is indistinguishable from viscous.
    omega = np.sqrt(known["power"] * known["weight"] / known["rest"])
    return {**known, "relaxation": np.exp(random.uniform(-4.0, 0.5, count)) / omega}


RELAXING_COLUMN = Law(
    name="relaxing-column",
    equation=("z'' + 2*lam*w = weight*((rest/z)**power - 1); w' = (z' - w)/relaxation"),
    start=_draw_start_values,
    positive=(*POWER_LAW_SPRING.positive, "relaxation"),
    units={**POWER_LAW_SPRING.units, "relaxation": "s"},
    source="column of grains that diffuses against drag, in one mode",
    resolution=2,
)
