"""A spring with slip elements of spread yield travels beside it: a bed that rubs on its plates.

W. D. Iwan's model (1966): a spring omega^2, and N elements, each a spring in series with a dry slider
(G. R. Jenkin 1922). Each of them carries friction/N at most, from a travel x_i on,

    x_i = travel ((i - 1/2)/N)^spread.

A column that friction holds evenly has spread = 2 and travel = friction/omega^2: sliding spreads from the
piston as the square root of its displacement after a turning point (`granular.linear.friction`). Six elements
are nearest to that, infinitely many, with spread = 1.55. The law of motion is a column's: of a bed that
sticks within an oscillation, one release does not tell friction, travel and spread from rest and bend, and
with all of them free a fit to it errs by 6 to 12 % on a release from half the lift. The law of force has them
as parameters; with spread = 0 all elements slip together. At rest the springs of the elements add their
stiffness: the frequency rises as the amplitude falls, and the piston stops away from the equilibrium,
``rest``.

The hidden state w_i is the force of an element over its largest one, at zero if the motion begins in a
bed without stress. Beyond 1 it falls back at the rate CREEP omega, so that the force is constant and no
step has to meet the moment of slip: a twentieth of 1/omega rounds turning points as little as a fiftieth
does (residuals of records of simulated beds, within 2 %).
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
"""Four leave 1.3 times as much of simulated records, eight as much as six."""
CREEP = 20
"""Rate at which an element that has slipped loses what exceeds its force, over omega."""
COLUMN_SPREAD = 1.55
"""Spread of the six elements of a column."""


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    # The frequency of a bed that sticks may be twice omega.
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
    """Rates of the hidden states, with the rate at which an element that has slipped falls back."""
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
    """Law whose fits start at the friction of a known bed."""
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
