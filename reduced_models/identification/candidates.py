"""The laws that an identification compares where nobody names any."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted, times
from reduced_models.identification.screening import HOPELESS, Screening, screened
from reduced_models.laws.catalogue import LAWS, law_named
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.inputs import column, column_names

CANDIDATES = (
    "linear", "van-der-pol-like", "polynomial-spring", "power-law-spring", "quadratic-drag",
    "coulomb", "duffing",
)  # fmt: skip
"""Laws that can win on a free swing; the others of the package are special cases or have memory."""
REFERENCE = "linear"
"""Is fitted in any case: what a better law is better than."""
_SPREAD = 1.5  # of the logarithm of a gain's start values


class Candidates(NamedTuple):
    """Laws to fit, and why others are not fitted.

    Attributes
    ----------
    laws : tuple of Law
    screening : Screening
    """

    laws: tuple[Law, ...]
    screening: Screening

    @property
    def left_out(self) -> tuple[str, ...]:
        """Those that cannot win, in words."""
        least = max(self.screening.least, 1.0)
        return tuple(
            f"{name} was not fitted: at a glance it leaves {times(misfit / least)} times what the "
            f"best law leaves (limit {HOPELESS:g}); --law {name} fits it all the same"
            for name, misfit in self.screening.misfits.items()
            if name not in {law.name for law in self.laws}
        )


def candidates(record: PistonRecord, drive: str | None = None) -> Candidates:
    """The laws that can win on a record, driven by one of its columns where that is named.

    Raises
    ------
    InputError
        If the record has no such column.
    """
    laws = tuple(LAWS[name] for name in CANDIDATES)
    if drive is not None:
        return Candidates(tuple(driven_law(law, record, drive) for law in laws), Screening({}, 1.0))
    screening = screened(record, laws)
    kept = tuple(law for law in laws if law.name == REFERENCE or not screening.hopeless(law.name))
    return Candidates(kept, screening)


def driven_law(law: Law, record: PistonRecord, drive: str) -> Law:
    """A law of the package with a column of a record, times a gain that is fitted, added to z''.

    Raises
    ------
    InputError
        If the record has no such column, or it does not change.
    """
    there = column_names(record)
    if drive not in there:
        found = ", ".join(map(quoted, there)) or "none"
        raise InputError(f"the record has no column {quoted(drive)}; further columns: {found}")
    if not drive.isidentifier() or drive in (*law.parameters, "gain", "z", "t", "pi", "e"):
        raise InputError(
            f"the column {quoted(drive)} cannot be named in an equation; rename it, such as to u"
        )
    size = float(np.abs(column(record, drive)).max())
    if not size > 0.0:
        raise InputError(f"the column {quoted(drive)} is zero everywhere; it drives nothing")
    own, gain = law_named(law.name).start, "gain"

    def start(
        guesses: FirstGuesses, random: np.random.Generator, count: int
    ) -> dict[str, np.ndarray]:
        assert own is not None
        strength = guesses.amplitude * guesses.frequency**2 / size
        logarithm = random.uniform(-2.0 * _SPREAD, 0.0, count)
        sign = np.where(random.uniform(size=count) < 0.5, -1.0, 1.0)
        return {**own(guesses, random, count), gain: sign * strength * np.exp(logarithm)}

    return dataclasses.replace(
        law,
        name=f"{law.name}, driven by {drive}",
        equation=law.equation.replace("z''", f"(z'' - {gain}*{drive})"),
        start=start,
        swing_form=None,
        inputs=(drive,),
        units={**law.units},
    )


def unused_columns(record: PistonRecord, laws: tuple[Law, ...]) -> tuple[str, ...]:
    """Columns that change in the course of the record, and that no law names."""
    named = {name for law in laws for name in law.inputs}
    return tuple(
        name
        for name in column_names(record)
        if name not in named and math.isfinite(spread := float(np.ptp(column(record, name))))
        and spread > 0.0
    )  # fmt: skip
