"""Scores of a discovered law: correct structure, and error of a free run."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.discovery.terms import terms_with_coefficients
from reduced_models.laws.law import HeightLine
from research.discovery.systems import (
    System,
    equivalent_term_sets,
    input_of_held_out_motion,
    solve_heights,
    times_and_heights_of_held_out_motion,
)

if TYPE_CHECKING:
    import sympy

USABLE = 0.05
"""Maximum error of a free run from a held-out start, in standard deviations of the true motion."""


class LawScore(NamedTuple):
    """Score of a law.

    Attributes
    ----------
    exact : bool
        True if its terms are the terms of the true law.
    error : float or None
        Root mean square error of a free run, in standard deviations of the true motion; None if the free run
        diverges.
    """

    exact: bool
    error: float | None

    @property
    def is_usable(self) -> bool:
        """True if the error of the free run is within `USABLE`."""
        return self.error is not None and self.error <= USABLE


def score_law(
    law: sympy.Expr,
    system: System,
    line: HeightLine = HeightLine(),  # noqa: B008  frozen
) -> LawScore:
    """Return the score of a law z'' = f(z, v, u), where z is ``line`` of the height."""
    return LawScore(_is_exact(law, system, line), _free_run_error(law, system, line))


def _is_exact(law: sympy.Expr, system: System, line: HeightLine) -> bool:
    if line.shift != 0.0:
        return False
    terms = terms_with_coefficients(law)
    return terms is not None and frozenset(item.text for item in terms) in equivalent_term_sets(system)


def _free_run_error(law: sympy.Expr, system: System, line: HeightLine) -> float | None:
    time, truth = times_and_heights_of_held_out_motion(system.name)
    height, velocity = system.unseen
    start = float(line.coordinate(height)), velocity / line.scale
    result = line.shift + line.scale * solve_heights(law, time, start, input_of_held_out_motion)
    error = float(np.sqrt(((result - truth) ** 2).mean()) / truth.std())
    return error if np.isfinite(error) else None
