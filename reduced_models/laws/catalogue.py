"""The packaged laws of motion, by name."""

from __future__ import annotations

from typing import Any

from granular.shared.registry import Registry
from reduced_models.laws.law import Law


def is_law_of_name(name: str, law: Any) -> bool:
    """Return True for a `Law` with the given name."""
    return isinstance(law, Law) and law.name == name


WANTED = "a reduced_models.Law of that name"

LAWS = Registry[Law](
    "law",
    "reduced_models.laws",
    # The simplest and best known first: among laws that a record cannot distinguish, the first one is chosen.
    {
        "linear": "reduced_models.laws.linear:LINEAR",
        "quadratic-drag": "reduced_models.laws.quadratic_drag:QUADRATIC_DRAG",
        "coulomb": "reduced_models.laws.coulomb:COULOMB",
        "viscous-coulomb": "reduced_models.laws.coulomb:VISCOUS_COULOMB",
        "viscous-quadratic": "reduced_models.laws.quadratic_drag:VISCOUS_QUADRATIC",
        "duffing": "reduced_models.laws.duffing:DUFFING",
        "polynomial-spring": "reduced_models.laws.polynomial_spring:POLYNOMIAL_SPRING",
        "power-law-spring": "reduced_models.laws.power_law_spring:POWER_LAW_SPRING",
        "van-der-pol": "reduced_models.laws.van_der_pol:VAN_DER_POL",
        "van-der-pol-like": "reduced_models.laws.van_der_pol_like:VAN_DER_POL_LIKE",
        "relaxing-column": "reduced_models.laws.relaxing_column:RELAXING_COLUMN",
        "pendulum-coulomb": "reduced_models.laws.pendulum:PENDULUM_COULOMB",
        "pendulum-quadratic": "reduced_models.laws.pendulum:PENDULUM_QUADRATIC",
        "bouc-wen": "reduced_models.laws.bouc_wen:BOUC_WEN",
        "rubbing-bed": "reduced_models.laws.rubbing_bed:RUBBING_BED",
        "elastoplastic-bed": "reduced_models.laws.elastoplastic_bed:ELASTOPLASTIC_BED",
        "annealing-bed": "reduced_models.laws.annealing_bed:ANNEALING_BED",
    },
    is_law_of_name,
    WANTED,
    lambda law: law.equation,
)
"""Laws of a free or driven motion, by name."""


def law_named(name: str) -> Law:
    """Return the law with a name.

    Parameters
    ----------
    name : str
        Name in `reduced_models.laws.LAWS`.

    Returns
    -------
    Law
        Law with that name.

    Raises
    ------
    InputError
        If no law has that name; the message gives the nearest name, or all names.

    Examples
    --------
    >>> from reduced_models import law_named
    >>> law_named("duffing").equation
    "z'' + 2*lam*z' + k*(z - rest) + beta*(z - rest)**3 = 0"
    """
    return LAWS.find(name)
