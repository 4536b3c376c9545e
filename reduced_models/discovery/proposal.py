"""A library proposed from the record: which one its integrals speak for, and in a word why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError
from reduced_models.discovery.libraries import LIBRARIES, PHYSICAL, terms_named
from reduced_models.discovery.selection import Judge, all_subsets, scored
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm

_CLEAR = 10.0
"""Difference of criteria from which another library is proposed (decisive evidence: Kass & Raftery
1995, doi:10.1080/01621459.1995.10476572)."""
_DEGREES = (3, 5)
_BETTER = 0.9
"""Held-out error, over that of a lower degree, up to which the degree grows."""
_WHY = {
    "polynomial": "springs or drag of a higher power",
    "trigonometric": "a pendulum, whose height is an angle",
    "rational": "a force that grows as the height goes to zero",
    "dry friction": "friction that depends on the swing",
    "contact": "a contact on one side of z = 0",
    "driven": "an input that changes the spring",
}


class Proposal(NamedTuple):
    """A library, and why.

    Attributes
    ----------
    name : str
    terms : tuple of terms
    why : str
        Empty where it is the usual one.
    """

    name: str
    terms: tuple[AnyTerm, ...]
    why: str


def proposed(weak: WeakForm, column: str | None) -> Proposal:
    """The library whose best sum of terms says most of the record for its price."""
    usual = _usual(weak, column)
    judged = {PHYSICAL: _best(weak, usual)}
    terms = {PHYSICAL: usual}
    for name in LIBRARIES:
        if name == PHYSICAL or (name == "driven" and column is None):
            continue
        own = terms_named(name, (), 3, column)
        if all(_is_tame(weak, term) for term in own):
            terms[name], judged[name] = own, _best(weak, own)
    # All in the same unit of misfit: that of the library which leaves least.
    excess = min(judge.excess for _, judge in judged.values())
    criteria = {
        name: judge.criterion(squares, 0) + (squares / excess - squares / judge.excess) + price
        for name, ((squares, price), judge) in judged.items()
    }
    best = min(criteria, key=lambda name: criteria[name])
    gain = criteria[PHYSICAL] - criteria[best]
    if gain < _CLEAR:
        return Proposal(PHYSICAL, usual, "")
    why = (
        f"the library {best!r} is taken, since the record speaks for {_WHY[best]}: its information "
        f"criterion is better than that of {PHYSICAL!r} by {min(gain, 9999.0):.0f}; name another by "
        "library="
    )
    return Proposal(best, terms[best], why)


def _is_tame(weak: WeakForm, term: AnyTerm) -> bool:
    """Whether a term is finite along the record, and no single moment outweighs the rest."""
    for motion in weak.motions:
        for z in (motion.z, motion.smooth):
            values = np.abs(term.values(z, motion.velocity, motion.drive))
            if not np.isfinite(values).all() or values.max() > _SPIKE * np.median(values) + _SPIKE:
                return False
    return True


_SPIKE = 1e4


def _best(weak: WeakForm, terms: Sequence[AnyTerm]) -> tuple[tuple[float, float], Judge]:
    """Squares of the best subset, the price of its terms, and its judge."""
    ranked, judge = scored(weak, terms, terms, all_subsets(len(terms)))
    best, count = ranked[0], len(ranked[0].terms)
    squares = best.misfit**2 * max(1, judge.rows - count)
    return (squares, judge.criterion(0.0, count)), judge


def _usual(weak: WeakForm, column: str | None) -> tuple[AnyTerm, ...]:
    """The physical library; its degree grows while that makes the error less that is held out."""
    chosen: tuple[AnyTerm, ...] = ()
    least = math.inf
    for degree in _DEGREES:
        terms = terms_named(PHYSICAL, (), degree, column)
        error = held_out_error(weak, terms)
        if not chosen or error < _BETTER * least:
            chosen, least = terms, error
        else:
            break
    return chosen


def held_out_error(weak: WeakForm, terms: Sequence[AnyTerm]) -> float:
    """Rms of the white residuals of a part of the integrals that the coefficients have not seen.

    Raises
    ------
    InputError
        If there are too few integrals.
    """
    whitening = weak.whitening((), np.zeros(0))
    matrix, target = whitening @ weak.matrix(terms), whitening @ weak.target
    # White rows have no order in time: every third one is held out.
    held = np.arange(len(target)) % 3 == 2
    if int((~held).sum()) <= len(terms):
        raise InputError(f"{len(target)} integrals are too few for {len(terms)} terms")
    sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    columns = matrix / sizes
    values = np.linalg.lstsq(columns[~held], target[~held], rcond=1e-10)[0]
    return float(np.sqrt(((target[held] - columns[held] @ values) ** 2).mean()))
