"""Law of an elastomer: a spring in parallel with Maxwell elements (spring and dashpot in series).

The spring of element i has the stiffness ki and the elongation xi, which relaxes through the dashpot with
the time constant taui: xi' = z' - xi/taui. With one element this is the standard linear solid (Zener
1948). Several elements with very different time constants describe the energy loss in rubber
over decades of frequency.
"""

from __future__ import annotations

from reduced_models.laws.law import Law

_SOURCE = "C. Zener, Elasticity and Anelasticity of Metals, 1948"


def make_maxwell_chain_law(name: str, order: int) -> Law:
    """Make the force law of a spring in parallel with ``order`` Maxwell elements."""
    numbers = range(1, order + 1)
    force = " + ".join(["k*z", *(f"k{i}*x{i}" for i in numbers), "zero"])
    rates = (f"x{i}' = z' - x{i}/tau{i}" for i in numbers)
    return Law(
        name,
        "; ".join([f"force = {force}", *rates]),
        positive=tuple(f"tau{i}" for i in numbers),
        units={"k": "N/m", "zero": "N"}
        | {f"k{i}": "N/m" for i in numbers}
        | {f"tau{i}": "s" for i in numbers},
        source=_SOURCE,
    )


STANDARD_LINEAR_SOLID = make_maxwell_chain_law("standard-linear-solid", 1)
MAXWELL_CHAIN = make_maxwell_chain_law("maxwell-chain", 2)
