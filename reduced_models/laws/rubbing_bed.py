"""A spring in parallel with slip elements of different yield travels: a bed that rubs on its plates.

W. D. Iwan's model (1966): a spring omega^2, and N elements, each a spring in series with a dry slider
(G. R. Jenkin 1922). Each carries a maximum force of friction/N, from a travel x_i on,

    x_i = travel ((i - 1/2)/N)^spread.

A column with uniform friction along its sides has spread = 2 and travel = friction/omega^2: after a turning
point, sliding spreads from the piston as the square root of its displacement (`granular.linear.friction`).
That is the limit of infinitely many elements; six elements approximate it best with spread = 1.55. The law of
motion has the constants of a column. If a bed sticks within an oscillation, one release does not separate
friction, travel and spread from rest and bend; with all of them free, a fit errs by 6 to 12 % on a release
from half the lift. The law of force has them as parameters; with spread = 0 all elements slip together. At
rest the springs of the elements add their stiffness: the frequency rises as the amplitude decreases, and the
piston stops away from the equilibrium, ``rest``.

The hidden state w_i is the force of an element over its maximum, zero if the motion begins in a bed without
stress. Beyond 1 it relaxes at the rate CREEP omega, so that the force is constant and no time step has to
resolve the onset of slip: a time of 1/(20 omega) rounds turning points as little as 1/(50 omega) (residuals
of simulated beds, within 2 %).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.laws.linear import split_damping
from reduced_models.records.first_guesses import FirstGuesses

if TYPE_CHECKING:
    from granular.linear import MotionFriction

ELEMENTS = 6
"""Number of slip elements: four give 1.3 times the residual on simulated records, eight the same as six."""
CREEP = 20
"""Relaxation rate of the excess force of an element that has slipped, over omega."""
COLUMN_SPREAD = 1.55
"""Spread of the six elements of a column."""


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
    return split_damping(values, "travel", guesses, random)


def _clipped(k: int) -> str:
    return f"min(max(w{k}, -1), 1)"


def slip_states(rate: str, spread: float | str = COLUMN_SPREAD) -> str:
    """Equations of the hidden states, for the relaxation rate of an element that has slipped."""
    return "; ".join(
        f"w{k}' = z'/(travel*{(k - 0.5) / ELEMENTS:.6g}**{spread}) - {rate}*(w{k} - {_clipped(k)})"
        for k in range(1, ELEMENTS + 1)
    )


SLIP_SUM = f"({' + '.join(_clipped(k) for k in range(1, ELEMENTS + 1))})/{ELEMENTS}"

RUBBING_BED = Law(
    name="rubbing-bed",
    equation=(
        f"z'' + 2*lam*z' + omega**2*((z - rest)*(1 + bend*(z - rest)) + travel*{SLIP_SUM}) = 0; "
        + slip_states(f"{CREEP}*omega")
    ),
    start=_draw_start_values,
    positive=("lam", "omega", "travel"),
    units={"lam": "1/s", "omega": "rad/s", "rest": "m", "bend": "1/m", "travel": "m"},
    source="W. D. Iwan 1966, doi:10.1115/1.3625199",
    resolution=4,
)


def rubbing_bed_near(known: MotionFriction) -> Law:
    """Law whose fits start from the friction of a known bed."""
    omega = 2.0 * np.pi * known.frequency
    values = {
        "lam": known.damping_ratio * omega,
        "omega": omega,
        "bend": 0.5 * known.bending / known.stiffness,
        "travel": known.force / known.stiffness,
    }

    def start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        near = {name: value * np.exp(0.1 * random.normal(size=count)) for name, value in values.items()}
        return _draw_start_values(guesses, random, count) | near

    return dataclasses.replace(RUBBING_BED, start=start)
