"""Problems whose motion is known to thirty digits, one a file."""

from __future__ import annotations

import importlib

from validation.exact.problem import Moment, Problem

NAMES = (
    "free-fall",
    "bounce",
    "oscillation",
    "scattering",
    "drag",
    "sliding",
    "driven-piston",
)

__all__ = ["NAMES", "Moment", "Problem", "exact_problem", "exact_problems"]


def exact_problem(name: str) -> Problem:
    """The exact problem of that name.

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
    from granular.schema.sections import unknown
    from granular.shared.errors import InputError

    if name not in NAMES:
        raise InputError(unknown(name, NAMES, "exact problem"))
    module = importlib.import_module(f"validation.exact.{name.replace('-', '_')}")
    found: Problem = module.problem()
    return found


def exact_problems() -> tuple[Problem, ...]:
    """All exact problems, in the order of `NAMES`.

    Examples
    --------
    >>> from validation import exact_problems
    >>> [problem.name for problem in exact_problems()][:3]
    ['free-fall', 'bounce', 'oscillation']
    """
    return tuple(exact_problem(name) for name in NAMES)
