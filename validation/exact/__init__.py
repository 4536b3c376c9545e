"""Problems whose motion is known to thirty digits."""

from __future__ import annotations

from collections.abc import Callable

from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from validation.exact import bounce, closed_forms, driven_piston, scattering
from validation.exact.problem import ExactProblem, GrainStates

__all__ = ["NAMES", "ExactProblem", "GrainStates", "exact_problem"]

_PROBLEMS: dict[str, Callable[[], ExactProblem]] = {
    "free-fall": closed_forms.free_fall_problem,
    "bounce": bounce.bounce_problem,
    "oscillation": bounce.oscillation_problem,
    "scattering": scattering.scattering_problem,
    "drag": closed_forms.drag_problem,
    "sliding": closed_forms.sliding_problem,
    "driven-piston": driven_piston.driven_piston_problem,
}
NAMES = tuple(_PROBLEMS)


def exact_problem(name: str) -> ExactProblem:
    """Return the exact problem of that name.

    Parameters
    ----------
    name : str
        One of `NAMES`.

    Returns
    -------
    ExactProblem
        Scene with its exact solution.

    Raises
    ------
    InputError
        If there is none; the nearest name is given.

    Examples
    --------
    >>> from validation import exact_problem
    >>> exact_problem("bounce").name
    'bounce'
    """
    if name not in NAMES:
        raise InputError(unknown_word_message(name, NAMES, "exact problem"))
    return _PROBLEMS[name]()
