"""A bed that carries a weight like a crystal of dipoles, and yields in shear when it is compressed.

Magnets compressed to a height z by a piston exert two forces. First, their mean pressure increases as a power
of the density: force = weight (rest/z)^power, with power = 5/2 for dipoles, the pressure of their
hexagonal lattice. Second, compression only from above also shears the bed. A lattice resists with a shear
stress, which is w times the pressure. The ratio w increases with the strain dz/z at a rate given by the
shear modulus, and saturates when the lattice yields,

    w' = -(modulus/z) (z' + |z'| |w| w/strength^2).

The bed is therefore stiffer for small motions than for large ones, and dissipates energy whenever it yields.
With w = 0 at all times the law is the power-law spring.

For a known scene three parameters are known: weight = g, power = 5/2, and lam = N gamma/(6 M), from the drag
coefficient gamma of N grains that follow the piston of mass M affinely.
"""

from __future__ import annotations

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    omega = guesses.draw_frequencies(random, count)
    # The law holds for heights above the floor; a record about zero needs another law.
    rest = np.maximum(np.abs(guesses.draw_rest_levels(random, count)), guesses.amplitude)
    power = np.exp(random.uniform(0.4, 1.6, count))
    modulus = np.exp(random.uniform(-2.5, 0.5, count))
    return {
        "lam": guesses.draw_decay_rates(random, count),
        "weight": omega**2 * rest / (power + 0.5 * modulus),
        "rest": rest,
        "power": power,
        "modulus": modulus,
        "strength": np.exp(random.uniform(-4.0, -1.5, count)),
    }


ELASTOPLASTIC_BED = Law(
    name="elastoplastic-bed",
    equation=(
        "z'' + 2*lam*z' = weight*((rest/z)**power*(1 + w) - 1); "
        "w' = -modulus/z*(z' + Abs(z')*Abs(w)*w/strength**2)"
    ),
    start=_draw_start_values,
    positive=("lam", "weight", "rest", "power", "modulus", "strength"),
    units={"lam": "1/s", "weight": "m/s^2", "rest": "m", "power": "1", "modulus": "1", "strength": "1"},
    source="pressure of the dipole lattice, and a shear stress that yields",
    resolution=2,
)
