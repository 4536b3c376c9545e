"""A bed with friction on its plates: a spring in parallel with slip elements of different yield travels.

The model is due to W. D. Iwan (1966): a spring omega^2, and N elements, each a spring in series with a dry
slider (G. R. Jenkin 1922). Each element slips at a force of friction/N, which it reaches at the travel x_i,

    x_i = travel ((i - 1/2)/N)^spread.

A column with uniform friction along its sides has spread = 2 and travel = friction/omega^2: after a turning
point, the sliding region extends from the piston in proportion to the square root of the piston's
displacement (`granular.linear.friction`). This holds for infinitely many elements; six elements approximate
it best with spread = 1.55.

In the law of motion, travel and spread are fixed to the values of a column: if a bed sticks within an
oscillation, a single release does not determine all five parameters friction, travel, spread, rest and bend
(a quadratic term of the spring). With all of them free, a fit predicts a release from half the lift with an
error of 6 to 12 %.
In the law of the force, travel and spread are parameters; with spread = 0 all elements slip together.

Without slip the springs of the elements add to the stiffness. The frequency therefore rises as the amplitude
decreases, and the piston stops away from the equilibrium, ``rest``.

The hidden state w_i is the force of an element divided by its maximum; it starts at zero in a bed without
stress. Beyond 1 it relaxes at the rate CREEP omega, so that the force stays constant and the onset of slip
requires no shorter time step. A relaxation time of 1/(20 omega) is short enough: residuals on simulated beds
differ by less than 2 % from those with 1/(50 omega).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.laws.linear import split_damping_at_random
from reduced_models.records.first_guesses import FirstGuesses

if TYPE_CHECKING:
    from granular.linear import MotionFriction

ELEMENTS = 6
"""Number of slip elements. On simulated records the residual with six elements is the same as with eight;
with four it is 1.3 times larger.
"""
CREEP = 20
"""Rate, divided by omega, at which the excess force of a slipping element relaxes."""
COLUMN_SPREAD = 1.55
"""Value of spread with which six elements approximate a column."""


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    # The frequency of a sticking bed may be twice omega.
    omega = guesses.draw_frequencies(random, count) * np.exp(random.uniform(-0.9, 0.0, count))
    travel = 0.5 * np.pi * guesses.draw_decay_rates(random, count) * guesses.amplitude / omega
    values = {
        "omega": omega,
        "rest": guesses.draw_rest_levels(random, count),
        "bend": random.uniform(-0.2, 0.1, count) / guesses.amplitude,
        "travel": travel,
    }
    return split_damping_at_random(values, "travel", guesses, random)


def _clipped_state_text(k: int) -> str:
    return f"min(max(w{k}, -1), 1)"


def slip_state_equations(rate: str, spread: float | str = COLUMN_SPREAD) -> str:
    """Return the equations of the hidden states; ``rate`` is the relaxation rate of a slipping element."""
    return "; ".join(
        f"w{k}' = z'/(travel*{(k - 0.5) / ELEMENTS:.6g}**{spread}) - {rate}*(w{k} - {_clipped_state_text(k)})"
        for k in range(1, ELEMENTS + 1)
    )


SLIP_SUM = f"({' + '.join(_clipped_state_text(k) for k in range(1, ELEMENTS + 1))})/{ELEMENTS}"

RUBBING_BED = Law(
    name="rubbing-bed",
    equation=(
        f"z'' + 2*lam*z' + omega**2*((z - rest)*(1 + bend*(z - rest)) + travel*{SLIP_SUM}) = 0; "
        + slip_state_equations(f"{CREEP}*omega")
    ),
    start=_draw_start_values,
    positive=("lam", "omega", "travel"),
    units={"lam": "1/s", "omega": "rad/s", "rest": "m", "bend": "1/m", "travel": "m"},
    source="W. D. Iwan 1966, doi:10.1115/1.3625199",
    resolution=4,
)


def rubbing_bed_with_starts_near(known: MotionFriction) -> Law:
    """Return the law with start values taken from the friction of a known bed."""
    omega = 2.0 * np.pi * known.frequency
    values = {
        "lam": known.damping_ratio * omega,
        "omega": omega,
        "bend": 0.5 * known.bending / known.stiffness,
        "travel": known.force / known.stiffness,
    }

    def draw_start_values(
        guesses: FirstGuesses, random: np.random.Generator, count: int
    ) -> dict[str, np.ndarray]:
        near = {name: value * np.exp(0.1 * random.normal(size=count)) for name, value in values.items()}
        return _draw_start_values(guesses, random, count) | near

    return dataclasses.replace(RUBBING_BED, start=draw_start_values)
