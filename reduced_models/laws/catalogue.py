"""The laws that come with the package, by their names."""

from __future__ import annotations

from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from granular.shared.registry import Registry
from reduced_models.laws.annealing_bed import ANNEALING_BED
from reduced_models.laws.bouc_wen import BOUC_WEN
from reduced_models.laws.coulomb import COULOMB, VISCOUS_COULOMB
from reduced_models.laws.duffing import DUFFING
from reduced_models.laws.elastoplastic_bed import ELASTOPLASTIC_BED
from reduced_models.laws.law import Law
from reduced_models.laws.linear import LINEAR
from reduced_models.laws.pendulum import PENDULUM_COULOMB, PENDULUM_QUADRATIC
from reduced_models.laws.polynomial_spring import POLYNOMIAL_SPRING
from reduced_models.laws.power_law_spring import POWER_LAW_SPRING
from reduced_models.laws.quadratic_drag import QUADRATIC_DRAG, VISCOUS_QUADRATIC
from reduced_models.laws.relaxing_column import RELAXING_COLUMN
from reduced_models.laws.rubbing_bed import RUBBING_BED
from reduced_models.laws.van_der_pol import VAN_DER_POL
from reduced_models.laws.van_der_pol_like import VAN_DER_POL_LIKE

# The simplest and best known first: of laws that a record cannot tell apart the first one counts.
_ALL = (
    LINEAR,
    QUADRATIC_DRAG,
    COULOMB,
    VISCOUS_COULOMB,
    VISCOUS_QUADRATIC,
    DUFFING,
    POLYNOMIAL_SPRING,
    POWER_LAW_SPRING,
    VAN_DER_POL,
    VAN_DER_POL_LIKE,
    RELAXING_COLUMN,
    PENDULUM_COULOMB,
    PENDULUM_QUADRATIC,
    BOUC_WEN,
    RUBBING_BED,
    ELASTOPLASTIC_BED,
    ANNEALING_BED,
)

LAWS = Registry(((law.name, law) for law in _ALL), lambda law: law.equation)


def law_named(name: str) -> Law:
    """Return the law of a name, from the catalogue of the package.

    Parameters
    ----------
    name : str
        Name in `reduced_models.laws.LAWS`.

    Returns
    -------
    Law
        Law of the catalogue.

    Raises
    ------
    InputError
        If it is the name of none; the message gives the nearest name, or all.

    Examples
    --------
    >>> from reduced_models import law_named
    >>> law_named("duffing").equation
    "z'' + 2*lam*z' + k*(z - rest) + beta*(z - rest)**3 = 0"
    """
    if not isinstance(name, str) or name not in LAWS:
        raise InputError(unknown_word_message(str(name), tuple(LAWS), "law"))
    return LAWS[name]
