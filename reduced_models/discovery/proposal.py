"""A library proposed from the record: which one its integrals speak for, and in a word why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.discovery.libraries import LIBRARIES, PHYSICAL, fault, terms_named
from reduced_models.discovery.selection import Judge, all_subsets, score_subsets, unit_columns
from reduced_models.discovery.terms import AnyTerm, in_order, sum_text
from reduced_models.discovery.weak_form import WeakForm, map_of, motion_of, weak_form
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod

AUTO = "auto"
_CLEAR = 10.0
"""Difference of criteria from which another library is proposed (decisive evidence: Kass & Raftery
1995, doi:10.1080/01621459.1995.10476572)."""
_DEGREES = (3, 5)
_BETTER = 0.5
"""Held-out error, over that of a lower degree, up to which the degree grows."""
_OF_THE_HEIGHT = ("trigonometric", "rational", "contact")
"""Libraries that mean something by z = 0."""
_WHY = {
    "polynomial": "a spring or a drag of a higher power",
    "trigonometric": "a pendulum, whose height is an angle",
    "rational": "a force that grows as the height goes to zero",
    "dry friction": "friction or drag of another form",
    "contact": "a contact on one side of z = 0",
    "driven": "an input that changes the spring",
}


class Proposal(NamedTuple):
    """A library for some records.

    Attributes
    ----------
    name : str
    terms : tuple of terms
    map : HeightMap
        Of the z that the terms mean.
    weak : WeakForm
        Of the records, in that z.
    note : str
        Why, where it is not the usual one.
    """

    name: str
    terms: tuple[AnyTerm, ...]
    map: HeightMap
    weak: WeakForm
    note: str


def propose_library(
    records: Sequence[PistonRecord],
    derivative: DerivativeMethod,
    column: str | None,
    wanted: HeightMap | str = AUTO,
    degree: int = _DEGREES[0],
) -> Proposal:
    """The library whose best sum of terms says most of the records for its price.

    Libraries that mean something by z = 0 are looked at where the records are of an angle, or swing
    about it, or where the map is given; negative powers where the height stays above zero.
    """
    usual_map = map_of(records, wanted)
    plain = usual_map == HeightMap() or isinstance(wanted, HeightMap)
    weak = weak_form(*(motion_of(each, usual_map, derivative, column) for each in records))
    usual = _usual(weak, column, degree)
    proposals = [Proposal(PHYSICAL, usual, usual_map, weak, "")]
    for name in LIBRARIES:
        own_map, own_weak = usual_map, weak
        if name == PHYSICAL or (name == "driven" and column is None):
            continue
        if name in _OF_THE_HEIGHT and not plain:
            if name == "contact" or (name == "trigonometric" and not records[0].angle):
                continue
            own_map = HeightMap()
            own_weak = weak_form(*(motion_of(one, own_map, derivative, column) for one in records))
        if name == "rational" and not all((one.z > 0.0).all() for one in own_weak.motions):
            continue
        terms = terms_named(name, (), 3, column)
        if not any(fault(motion, term) for motion in own_weak.motions for term in terms):
            proposals.append(Proposal(name, terms, own_map, own_weak, ""))
    return _chosen(proposals)


class _Judged(NamedTuple):
    """The best sum of a library's terms: its squares, the price of its terms, and its judge."""

    terms: tuple[AnyTerm, ...]
    squares: float
    price: float
    judge: Judge


def _chosen(proposals: Sequence[Proposal]) -> Proposal:
    judged = [_best(one) for one in proposals]
    # All in one unit of misfit: that of the library which leaves least.
    excess = min(one.judge.excess for one in judged)
    criteria = [one.squares / excess + one.price for one in judged]
    best = int(np.argmin(criteria))
    gain = criteria[0] - criteria[best]
    if gain < _CLEAR or set(judged[best].terms) <= set(proposals[0].terms):
        best = 0
    found = proposals[best]
    notes = []
    if best:
        notes.append(
            f"the terms are those of the library {found.name!r}: the record speaks for "
            f"{_WHY[found.name]} (information criterion {_figure(gain)} below that of "
            f"{PHYSICAL!r}); another library: library="
        )
        usual = judged[0]
        if (usual.squares - judged[best].squares) / excess < _CLEAR:
            notes.append(
                f"the data cannot tell whether it is that or {sum_text(usual.terms)}, which fits "
                f"as well with {len(usual.terms)} numbers for {len(judged[best].terms)}"
            )
    alike = {
        sum_text(one.terms): proposal.name
        for proposal, one, value in zip(proposals, judged, criteria, strict=True)
        if value < criteria[best] + _CLEAR
        and set(one.terms) != set(judged[best].terms)
        and len(one.terms) <= len(judged[best].terms)
    }
    if alike:
        others = ", ".join(f"{text} ({name})" for text, name in alike.items())
        notes.append(
            f"the data cannot tell {sum_text(judged[best].terms)} of the library {found.name!r} "
            f"from {others}"
        )
    return found._replace(note="; ".join(notes))


def _figure(gain: float) -> str:
    return f"{gain:.0f}" if gain < 1e4 else "far"


def _best(proposal: Proposal) -> _Judged:
    terms = proposal.terms
    ranked, judge = score_subsets(proposal.weak, terms, terms, all_subsets(len(terms)))
    best = ranked[0]
    count = len(best.terms)
    squares = best.misfit**2 * max(1, judge.rows - count)
    return _Judged(tuple(in_order(best.terms)), squares, judge.criterion(0.0, count), judge)


def _usual(weak: WeakForm, column: str | None, least_degree: int) -> tuple[AnyTerm, ...]:
    """The physical library; its degree grows while that makes the error less that is held out."""
    chosen: tuple[AnyTerm, ...] = ()
    least = math.inf
    for degree in (least_degree, *(one for one in _DEGREES if one > least_degree)):
        terms = terms_named(PHYSICAL, (), degree, column)
        error = held_out_error(weak, terms)
        if chosen and error > _BETTER * least:
            break
        chosen, least = terms, error
    return chosen


def held_out_error(weak: WeakForm, terms: Sequence[AnyTerm]) -> float:
    """Rms of every third white residual, with coefficients that have not seen it.

    Infinite where there are fewer integrals than terms.
    """
    whitening = weak.whitening((), np.zeros(0))
    matrix, target = whitening @ weak.matrix(terms), whitening @ weak.target
    held = np.arange(len(target)) % 3 == 2
    if int((~held).sum()) <= len(terms):
        return math.inf
    columns, _ = unit_columns(matrix)
    values = np.linalg.lstsq(columns[~held], target[~held], rcond=1e-10)[0]
    return float(np.sqrt(((target[held] - columns[held] @ values) ** 2).mean()))
