"""A column of grains that follows its piston late: drag that relaxes, in one mode.

The power-law spring is a column whose grains follow the piston affinely. Against drag they cannot:
a column of N grains with the drag gamma, stiffness k at the piston, is a line along which the
displacement diffuses. Held at its floor and moved by s = i omega N gamma/k at its top, its
stiffness over that at rest is f(s) = sqrt(s) coth sqrt(s) = 1 + s/3 - s^2/45 + ... One mode, with
the first two of these terms right, is

    f(s) = 1 + (s/3)/(1 + s/15):

affine drag, a third of that of all grains, which follows the speed with the time N gamma/(15 k). As
a law of motion the drag is 2 lam w, where the speed w of the grains comes after that of the piston,

    w' = (z' - w)/relaxation.

Where a scene is known, lam = N gamma/(6 M), power = 5/2, weight = g and, as k is power M g/rest,
relaxation = 2 lam rest/(5 power g). In the packaged damper that is a millisecond; it is taken as
the same at all heights. Without it (relaxation to zero) the law is the power-law spring.
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
    # From a hundredth of the swing's radian on: below that the drag is as if it did not relax.
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
