"""Structures with memory: sums of terms that hold a hidden state, whose values the record tells.

A hidden state is known along the record once its inner scales are: it follows from the heights
before. So it enters the terms as an input would, and all that judges sums of terms judges these as
well. The scales are those at which all terms together leave least, on a grid that is refined; each
is paid for as a term's number is.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError
from reduced_models.discovery.hidden_states import DAMPER_STATES, HIDDEN_STATES, HiddenState, Memory
from reduced_models.discovery.libraries import MEMORY, custom_terms
from reduced_models.discovery.polishing import parametrise
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.selection import (
    Judge,
    ScoredTerms,
    all_subsets,
    common_unit_judges,
    normalise_columns,
    score_subsets,
)
from reduced_models.discovery.structures import Search, Structures, make_candidate, symbolic_candidates
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import ForceIntegrals, WeakForm, noise_free_weak_form

HIDDEN = "w"
"""Name of the hidden state's fraction of the force in own terms."""
PLAIN_TERMS = ("1", "z**-2", "z**-2.5", "z**-3", "z'", "z'/z", "abs(z')*z'", "sign(z')*z**-2.5")
"""Weight, the pressure of a bed that is squeezed, drag, and friction that grows with the pressure.
"""
DAMPER_TERMS = ("1", "z", "z**3", "z'", "abs(z')*z'", "sign(z')")
"""Springs, drag and dry friction of a damper on a stroke about zero."""
HIDDEN_TERMS = ("w", "w*z**-2", "w*z**-2.5", "w*z**-3")
_CLEAR = 10.0
"""Difference of criteria that is decisive (Kass & Raftery 1995)."""
_FAR = 10.0
"""Noise levels left by the best sums, from which on they are not weighed by that noise."""
_FINER = 9
"""Values of each scale on the finer grids."""
_ROUNDS = 2
_RETAINED = 20
"""Sums of each hidden state that are candidates."""


class _StateScores(NamedTuple):
    """The best sums with one hidden state, or with none."""

    memory: Memory | None
    ranked: list[ScoredTerms]
    judge: Judge


def structures_with_memory(
    weak: WeakForm, search: Search | None, terms: Sequence[str] = (), sparse: bool = True
) -> Structures:
    """Candidates with the hidden state that sums need most, or with none; z is the height [m].

    Parameters
    ----------
    weak : WeakForm
        Of z'' or of the measured force of beds without strain at their starts.
    search : Search, optional
        Of a symbolic regression of F(z, z', w), with the hidden state that sums need.
    terms : sequence of str
        Own terms next to those of the library, in z, z' and w.
    sparse : bool
        Whether sums of terms are candidates, next to what a search proposes.

    Raises
    ------
    InputError
        If a height of a free motion is not above zero, or a text is no term.
    """
    force = isinstance(weak.parts[0], ForceIntegrals)
    states: Sequence[HiddenState] = HIDDEN_STATES
    plain_texts: Sequence[str] = PLAIN_TERMS
    hidden_texts: Sequence[str] = HIDDEN_TERMS
    if any(motion.z.min() <= 0.0 for motion in weak.motions):
        if not force:
            raise InputError(
                f"library = {MEMORY!r} is about strains of a bed, but a height is not above zero; give "
                "heights above the floor"
            )
        states, plain_texts, hidden_texts = DAMPER_STATES, DAMPER_TERMS, (HIDDEN,)
    plain = custom_terms(plain_texts, HIDDEN)
    known = tuple(dict.fromkeys((*plain, *custom_terms((*hidden_texts, *terms), HIDDEN))))
    judged = _score_states(weak, known, states)
    if not force and min(candidate.judge.excess for candidate in judged) > _FAR**2:
        judged = _score_states(noise_free_weak_form(weak), known, states)
    judges = common_unit_judges([candidate.judge for candidate in judged])
    judged = [candidate._replace(judge=judge) for candidate, judge in zip(judged, judges, strict=True)]
    groups = [_candidates_of_states(candidate) for candidate in judged]
    best = min(range(len(judged)), key=lambda k: groups[k][0].criterion)
    candidates = [study for group in groups for study in group] if sparse else []
    if search is not None:
        candidates += _search_candidates(judged[best], known, search)
    if force:
        candidates = [dataclasses.replace(candidate, left="force") for candidate in candidates]
    memory, judge = judged[best].memory, judged[best].judge
    state = None if memory is None else memory.state
    return Structures(
        [candidate for candidate in candidates if _candidate_state(candidate) is state],
        judge,
        others=[item for item in pareto_front(candidates) if _candidate_state(item) is not state],
        notes=_memory_notes(groups, best),
        memory=memory,
    )


def _candidate_state(candidate: CandidateEquation) -> HiddenState | None:
    return None if candidate.memory is None else candidate.memory.state


def _score_states(
    weak: WeakForm, known: Sequence[AnyTerm], states: Sequence[HiddenState]
) -> list[_StateScores]:
    """Best sums without a hidden state, and with each of them."""
    still = tuple(item for item in known if not item.driven)
    white = _WhitenedColumns(weak, known)
    return [
        _StateScores(None, *score_subsets(weak, still, still, all_subsets(len(still)))),
        *(_score_state(state, white, known) for state in states),
    ]


class _WhitenedColumns:
    """White columns of a weak form, of which those without a hidden state stay as they are."""

    def __init__(self, weak: WeakForm, known: Sequence[AnyTerm]) -> None:
        self.weak = weak
        self.whitening = weak.whitening((), np.zeros(0))
        self.target = self.whitening @ weak.target
        self.still = self.whitening @ weak.matrix([item for item in known if not item.driven])
        self.driven = [item for item in known if item.driven]

    def least(self, state: HiddenState, scales: np.ndarray) -> int:
        """Index of the scales (k, s) that leave the least squares, with all terms."""
        squares = []
        for item in _weak_form_with_state(self.weak, state, scales):
            columns = np.hstack([self.still, self.whitening @ item.matrix(self.driven)])
            columns, _ = normalise_columns(columns)
            left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
            squares.append(float(left @ left))
        return int(np.argmin(squares))


def _score_state(state: HiddenState, white: _WhitenedColumns, known: Sequence[AnyTerm]) -> _StateScores:
    """Best sums with a hidden state, at the scales where all terms together leave least."""
    weak = white.weak
    scales = state.tried(weak.motions[0].period)
    lows, highs = scales.min(axis=0), scales.max(axis=0)
    best = scales[white.least(state, scales)]
    width = _grid_ratio(scales)
    for _ in range(_ROUNDS):
        grid = best * width ** np.linspace(-1.0, 1.0, _FINER)[:, None]
        for k in range(len(best)):  # one scale after the other
            scales = np.tile(best, (_FINER, 1))
            scales[:, k] = np.clip(grid[:, k], lows[k], highs[k])
            best = scales[white.least(state, scales)]
        width = width ** (2.0 / (_FINER - 1))
    strained = _weak_form_with_state(weak, state, best[None])[0]
    ranked, judge = score_subsets(strained, known, known, all_subsets(len(known)))
    return _StateScores(Memory(state, tuple(map(float, best))), ranked, judge)


def _grid_ratio(scales: np.ndarray) -> np.ndarray:
    """Ratio of neighbours on the first grid, scale by scale."""
    different = [np.unique(column) for column in scales.T]
    return np.array([float((item[1:] / item[:-1]).max()) for item in different])


def _weak_form_with_state(weak: WeakForm, state: HiddenState, scales: np.ndarray) -> list[WeakForm]:
    """Weak form with the hidden state as its input, for each of the scales (k, s)."""
    values = [state.values(motion.time, motion.smooth, scales) for motion in weak.motions]
    return [
        WeakForm(
            tuple(
                dataclasses.replace(part, motion=part.motion._replace(drive=value[k]))
                for part, value in zip(weak.parts, values, strict=True)
            )
        )
        for k in range(len(scales))
    ]


def add_hidden_state(candidate: CandidateEquation, memory: Memory | None, judge: Judge) -> CandidateEquation:
    """Return a candidate with its hidden state, whose scales cost what other numbers do."""
    if memory is None or candidate.memory is not None:
        return candidate
    count = len(memory.scales)
    return dataclasses.replace(
        candidate,
        memory=memory,
        complexity=candidate.complexity + count,
        criterion=candidate.criterion + count * math.log(judge.weak.samples),
    )


def _reweigh_candidate(candidate: CandidateEquation, count: int, judged: _StateScores) -> CandidateEquation:
    """Candidate with so many numbers by the common unit of misfit, with its hidden state."""
    judge = judged.judge
    criterion = judge.criterion(judge.squares(candidate.error, count), count)
    again = dataclasses.replace(candidate, criterion=criterion)
    return add_hidden_state(again, judged.memory, judge)


def _candidates_of_states(judged: _StateScores) -> list[CandidateEquation]:
    """Best sums first; one that does not hold the hidden state is one without memory."""
    candidates = [
        _reweigh_candidate(make_candidate(candidate), len(candidate.terms), judged)
        for candidate in judged.ranked
        if judged.memory is None or any(term.driven for term in candidate.terms)
    ]
    return sorted(candidates, key=lambda candidate: candidate.criterion)[:_RETAINED]


def _search_candidates(
    judged: _StateScores, known: Sequence[AnyTerm], search: Search
) -> list[CandidateEquation]:
    """Candidates of a symbolic regression, with the hidden state as a variable."""
    if judged.memory is None:
        return []
    terms = [item for item in known if item.driven or item.still]
    candidates, _ = symbolic_candidates(judged.judge.weak, terms, search)
    return [
        _reweigh_candidate(candidate, len(parametrise(candidate.expression)[1]), judged)
        for candidate in candidates
    ]


def _memory_notes(groups: Sequence[Sequence[CandidateEquation]], best: int) -> tuple[str, ...]:
    """Gain by the hidden state, and others that do as well."""
    lead = groups[best][0]
    if lead.memory is None:
        return ("no hidden state that was tried is worth its numbers: the law has no memory",)
    gain = groups[0][0].criterion - lead.criterion
    notes = [
        f"the force has memory: with a {lead.memory.state.name} the information criterion is "
        f"{gain:.4g} below that of the best sum without"
    ]
    alike = [
        group[0].memory.state.name
        for group in groups
        if group[0] is not lead
        and group[0].memory is not None
        and group[0].criterion < lead.criterion + _CLEAR
    ]
    if alike:
        notes.append(f"the data cannot tell it from {', '.join(alike)}")
    return tuple(notes)
