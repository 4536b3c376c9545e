"""A bed that yields as it falls, and hardens as it orders.

The elastoplastic bed has one modulus and one strength. A bed of magnets that has come to rest is
stiffer than the one that fell, and yields later: its grains have settled into a lattice,
and large strains take them out of it again. A second hidden state, the order q of the bed, says
how far that has gone. It is 0 in the bed that is released, grows towards 1 in time, and falls with
plastic strain, which is the fraction w^4/y^4 of the strain where the bed yields at y:

    w' = -(modulus (1 + STIFFENING q)/z) (z' + |z'| |w|^3 w/y^4),    y = strength (1 + HARDENING q),
    q' = (1 - q)/TIME - q |z'| w^4/(PLASTIC z y^4).

It yields more sharply than the elastoplastic bed, w^4 in place of w^2: a fall does not tell one
from the other, but a bed at rest that swings by 0.5 to 1.5 D loses less than w^2 says.

The numbers of the order were fitted once, with modulus and strength, to what one bed of 368 grains
does, the packaged damper: falls from 14 to 28 D, lifts by 0.2 to 4 D after it has come to rest, the
work of prescribed sines of 0.5 to 3 D at 1 to 8 Hz, and the motion of pistons that are pushed at 1
to 8 Hz (least squares of all errors; exponents 2, 3, 4, 6 and 8 leave 30.1, 26.9, 26.1, 25.7 and
29.7). With weight = g, power = 5/2 and the affine drag, these numbers tell all that of a bed of 736
grains as well. What is left to fit are the numbers of the elastoplastic bed, whose derivation is
given with it.
"""

from __future__ import annotations

from reduced_models.laws.elastoplastic_bed import ELASTOPLASTIC_BED
from reduced_models.laws.law import Law

MODULUS, STRENGTH = 0.309, 0.0388
"""Value of beds without order, at all sizes from 368 grains on."""
STIFFENING, HARDENING = 0.225, 0.744
"""Increase of modulus and strength by order, over their values without order."""
TIME = 3.1
"""Time in which the bed orders [s]; anything from 1 to 30 tells the beds nearly as well."""
PLASTIC = 0.317
"""Plastic strain by which order falls to 1/e."""

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
    source="pressure of the dipole lattice, and a shear stress that yields later as the bed orders",
    resolution=2,
)
