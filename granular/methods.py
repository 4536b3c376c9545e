"""Integration methods, each one table of coefficients run by the same loop.

A step alternates kicks (velocities, positions frozen; drag is solved with the kick, exactly) and
drifts (positions, velocities frozen): kick b_0, drift a_1, kick b_1, ..., drift a_s, kick b_s, with
the fractions of the step below. Symplectic for conservative scenes by construction.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.errors import InputError
from granular.schema import unknown


@dataclasses.dataclass(frozen=True)
class Method:
    """A composition method.

    Attributes
    ----------
    name, source : str
    order : int
        Order of convergence.
    kicks, drifts : tuple of float
        Fractions of the step; one kick more than drifts.
    """

    name: str
    order: int
    kicks: tuple[float, ...]
    drifts: tuple[float, ...]
    source: str

    def tables(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.kicks), np.array(self.drifts)


STORMER_VERLET = Method(
    name="stormer-verlet",
    order=2,
    kicks=(0.5, 0.5),
    drifts=(1.0,),
    source="Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144",
)

METHODS = {method.name: method for method in (STORMER_VERLET,)}


def method_named(name: str) -> Method:
    """The method of that name.

    Raises
    ------
    InputError
        If there is none; the nearest name is given.
    """
    if name not in METHODS:
        raise InputError(unknown(str(name), tuple(METHODS), "method"))
    return METHODS[name]
