"""A bed that yields in shear, and whose modulus and strength increase as its grains become ordered.

The elastoplastic bed (`reduced_models.laws.elastoplastic_bed`) has one modulus, one strength and one hidden
state w, the ratio of shear stress to pressure. A bed of magnets that has come to rest is stiffer than the
falling bed and yields at a larger strain: its grains have settled into a lattice. Large strains disorder the
lattice again. A second hidden state q therefore describes the order of the bed. It is 0 at release, increases
towards 1 in time, and decreases with plastic strain. The plastic strain is the fraction w^4/y^4 of the
strain, so all further strain is plastic at w = y:

    w' = -(modulus (1 + STIFFENING q)/z) (z' + |z'| |w|^3 w/y^4),    y = strength (1 + HARDENING q),
    q' = (1 - q)/TIME - q |z'| w^4/(PLASTIC z y^4).

This bed yields more sharply than the elastoplastic bed, since w^4 replaces w^2. In falls the two laws cannot
be distinguished, but a settled bed that oscillates by 0.5 to 1.5 grain diameters D loses less energy than
with w^2.

The constants in capitals were fitted once, with modulus and strength, to simulations of one bed of 368
grains, the packaged damper:

- falls from 14 to 28 D, and releases from lifts of 0.2 to 4 D after the bed has come to rest;
- the work in prescribed sinusoidal strokes of 0.5 to 3 D at 1 to 8 Hz;
- the motion of pistons driven at 1 to 8 Hz.

The sum of all squared errors was minimised; the exponents 2, 3, 4, 6 and 8 of w give sums of 30.1, 26.9,
26.1, 25.7 and 29.7. With the parameters weight = g, power = 5/2 and affine drag, these constants predict
the same motions of a bed of 736 grains equally well. The parameters of a fit, and their derivation, are the
same as for the elastoplastic bed.
"""

from __future__ import annotations

from reduced_models.laws.elastoplastic_bed import ELASTOPLASTIC_BED
from reduced_models.laws.law import Law

MODULUS, STRENGTH = 0.309, 0.0388
"""Modulus and strength of a bed without order (q = 0), for beds of 368 grains or more."""
STIFFENING, HARDENING = 0.225, 0.744
"""Relative increases of modulus and strength from q = 0 to q = 1."""
TIME = 3.1
"""Time constant of ordering [s]; values from 1 to 30 describe the beds nearly as well."""
PLASTIC = 0.317
"""Plastic strain that reduces the order q to 1/e."""

_STRENGTH = f"(strength*(1 + {HARDENING!r}*q))"

ANNEALING_BED = Law(
    name="annealing-bed",
    equation=(
        "z'' + 2*lam*z' = weight*((rest/z)**power*(1 + w) - 1); "
        f"w' = -modulus*(1 + {STIFFENING!r}*q)/z*(z' + Abs(z')*Abs(w)**3*w/{_STRENGTH}**4); "
        f"q' = (1 - q)/{TIME!r} - q*Abs(z')*w**4/({PLASTIC!r}*z*{_STRENGTH}**4)"
    ),
    start=ELASTOPLASTIC_BED.start,
    positive=ELASTOPLASTIC_BED.positive,
    units=ELASTOPLASTIC_BED.units,
    source=(
        "pressure of the dipole lattice, and a shear stress whose yield limit increases with the "
        "order of the bed"
    ),
    resolution=2,
)
