"""Options of an identification, checked before anything is computed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from concurrent.futures import Executor
from numbers import Real

from granular.shared.errors import InputError
from granular.shared.message_text import quote

BUDGET = 300.0
"""Processor time for discovery and fits [s], ten times what a damper's motion takes."""


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """Rare options of `identify`: its time, and the checks of a simulated record.

    Parameters
    ----------
    budget : float
        Processor time for discovery and fits [s], above 0. Laws that come later are not fitted, and a
        note names them; half of the time is for a discovery.
    checks : bool
        Whether the scene also runs with another time step and from other random starts, which gives the
        figures their step error and scatter, and with another lift, which all laws then have to predict.
        If no laws are named and the scene begins with a fall, laws of the whole fall
        (`reduced_models.falls.unseen_fall_scores.FALL_LAWS`) are fitted to it, and judged on falls from
        other heights and random starts. A check that fails becomes a note.
    executor : concurrent.futures.Executor, optional
        Where the checks run, as in `granular.sweep`; processes on this machine if not given.
    parts : mapping of str to str or float, optional
        Tolerances of the scene's parts, as `granular.tolerances` takes them: the standard deviations that
        they give the figures of small motions are printed apart from the errors of the figures.

    Raises
    ------
    InputError
        If the budget is not a time above 0.

    Examples
    --------
    >>> from reduced_models import IdentifyOptions
    >>> IdentifyOptions(checks=False).budget
    300.0
    """

    budget: float = BUDGET
    checks: bool = True
    executor: Executor | None = None
    parts: Mapping[str, str | float] | None = None

    def __post_init__(self) -> None:
        check_budget(self.budget)


def check_budget(budget: object) -> None:
    """Refuse a processor time [s] that is not above 0."""
    if not isinstance(budget, Real) or not float(budget) > 0.0:
        raise InputError(f"budget = {quote(budget)} s; give a time above 0")
