"""The columns of a record: what is kept of the present moment at the end of a tick."""

from __future__ import annotations

COLUMNS = (
    "time",
    "height",
    "velocity",
    "left",
    "right",
    "bottom",
    "top",
    "kinetic",
    "pair",
    "wall",
    "weight",
    "contact",
    "piston",
    "work",
    "drag_loss",
    "friction_loss",
    "contact_loss",
    "piston_loss",
    "closest",
    "fastest",
    "stiffest",
    "grains",
    "turned",
)
"""Time; height and velocity of the piston; the force on each wall; the energies of the grains
(kinetic, of pairs, at walls, weight, contacts) and of the piston; the ledger (work from outside,
losses); the least distance of two grains, the greatest speed, and the bound of the highest angular
frequency that the bed can meet; the number of grains; the energy turned over so far. In natural
units."""

# Kernels take whole numbers, not texts; a test holds both lists together.
(
    TIME,
    HEIGHT,
    VELOCITY,
    LEFT,
    RIGHT,
    BOTTOM,
    TOP,
    KINETIC,
    PAIR,
    WALL,
    WEIGHT,
    CONTACT,
    PISTON,
    WORK,
    DRAG_LOSS,
    FRICTION_LOSS,
    CONTACT_LOSS,
    PISTON_LOSS,
    CLOSEST,
    FASTEST,
    STIFFEST,
    GRAINS,
    TURNED,
) = range(len(COLUMNS))
