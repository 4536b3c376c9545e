"""What a discovered law is worth: is its structure the true one, and does it predict?"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.discovery.terms import split_terms
from reduced_models.laws.law import HeightLine
from research.discovery.systems import System, right_structures, solved, unseen_motion, unseen_push

if TYPE_CHECKING:
    import sympy

USABLE = 0.05
"""Greatest error of a free run from an unseen start, in standard deviations of the true motion."""


class Worth(NamedTuple):
    """What a law is worth.

    Attributes
    ----------
    exact : bool
        Whether its terms are those of the true law.
    error : float or None
        Root mean square of a free run less the true motion, in standard deviations of the latter;
        None where the free run runs away.
    """

    exact: bool
    error: float | None

    @property
    def usable(self) -> bool:
        """Whether the free run is within `USABLE`."""
        return self.error is not None and self.error <= USABLE


def worth(
    law: sympy.Expr,
    system: System,
    line: HeightLine = HeightLine(),  # noqa: B008  frozen
) -> Worth:
    """What a law z'' = f(z, v, u) is worth, where z is ``line`` of the height."""
    return Worth(_is_exact(law, system, line), _free_run_error(law, system, line))


def _is_exact(law: sympy.Expr, system: System, line: HeightLine) -> bool:
    if line.shift != 0.0:
        return False
    terms = split_terms(law)
    return terms is not None and frozenset(item.text for item in terms) in right_structures(system)


def _free_run_error(law: sympy.Expr, system: System, line: HeightLine) -> float | None:
    time, truth = unseen_motion(system.name)
    height, velocity = system.unseen
    start = float(line.coordinate(height)), velocity / line.scale
    result = line.shift + line.scale * solved(law, time, start, unseen_push)
    error = float(np.sqrt(((result - truth) ** 2).mean()) / truth.std())
    return error if np.isfinite(error) else None
