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
from reduced_models.discovery.hidden_states import (
    DAMPER_STATES,
    HIDDEN_STATES,
    HiddenState,
    ScaledHiddenState,
)
from reduced_models.discovery.polishing import replace_numbers_by_symbols
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.structure_proposals import (
    ProposedStructures,
    SymbolicSearch,
    candidate_from_terms,
    propose_symbolic_candidates,
)
from reduced_models.discovery.subset_selection import (
    EquationScorer,
    ScoredTerms,
    all_index_subsets,
    normalise_columns,
    score_subsets,
    scorers_in_common_unit,
)
from reduced_models.discovery.term_libraries import MEMORY, parse_custom_terms
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import ForceIntegrals, WeakForm, white_noise_weak_form

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


class _HiddenStateScores(NamedTuple):
    """The best sums with one hidden state, or with none."""

    hidden_state: ScaledHiddenState | None
    ranked: list[ScoredTerms]
    scorer: EquationScorer


def propose_hidden_state_structures(
    weak: WeakForm, search: SymbolicSearch | None, terms: Sequence[str] = (), sparse: bool = True
) -> ProposedStructures:
    """Propose equations with the hidden state that sums of terms need most, or with none."""
    # z is the height [m] here, since strains are meant.
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
    plain = parse_custom_terms(plain_texts, HIDDEN)
    known = tuple(dict.fromkeys((*plain, *parse_custom_terms((*hidden_texts, *terms), HIDDEN))))
    scored = _score_hidden_states(weak, known, states)
    if not force and min(candidate.scorer.excess for candidate in scored) > _FAR**2:
        scored = _score_hidden_states(white_noise_weak_form(weak), known, states)
    scorers = scorers_in_common_unit([candidate.scorer for candidate in scored])
    scored = [candidate._replace(scorer=scorer) for candidate, scorer in zip(scored, scorers, strict=True)]
    groups = [_candidates_with_state(candidate) for candidate in scored]
    best = min(range(len(scored)), key=lambda k: groups[k][0].criterion)
    candidates = [study for group in groups for study in group] if sparse else []
    if search is not None:
        candidates += _symbolic_candidates_with_state(scored[best], known, search)
    if force:
        candidates = [dataclasses.replace(candidate, left_side="force") for candidate in candidates]
    hidden_state, scorer = scored[best].hidden_state, scored[best].scorer
    state = None if hidden_state is None else hidden_state.kind
    return ProposedStructures(
        [candidate for candidate in candidates if _candidate_state(candidate) is state],
        scorer,
        others=[item for item in pareto_front(candidates) if _candidate_state(item) is not state],
        notes=_hidden_state_notes(groups, best),
        hidden_state=hidden_state,
    )


def _candidate_state(candidate: CandidateEquation) -> HiddenState | None:
    return None if candidate.hidden_state is None else candidate.hidden_state.kind


def _score_hidden_states(
    weak: WeakForm, known: Sequence[AnyTerm], states: Sequence[HiddenState]
) -> list[_HiddenStateScores]:
    """Best sums without a hidden state, and with each of them."""
    stateless = tuple(item for item in known if not item.has_input)
    whitened = _WhitenedColumns(weak, known)
    return [
        _HiddenStateScores(
            None, *score_subsets(weak, stateless, stateless, all_index_subsets(len(stateless)))
        ),
        *(_score_hidden_state(state, whitened, known) for state in states),
    ]


class _WhitenedColumns:
    """White columns of a weak form, of which those without a hidden state stay as they are."""

    def __init__(self, weak: WeakForm, known: Sequence[AnyTerm]) -> None:
        self.weak = weak
        self.whitening = weak.whitening_matrix((), np.zeros(0))
        self.target = self.whitening @ weak.target
        self.fixed_columns = self.whitening @ weak.term_integral_matrix(
            [item for item in known if not item.has_input]
        )
        self.state_terms = [item for item in known if item.has_input]

    def best_scales_index(self, state: HiddenState, scales: np.ndarray) -> int:
        """Index of the scales (k, s) that leave the least squares, with all terms."""
        squares = []
        for item in _weak_form_with_state(self.weak, state, scales):
            columns = np.hstack(
                [self.fixed_columns, self.whitening @ item.term_integral_matrix(self.state_terms)]
            )
            columns, _ = normalise_columns(columns)
            left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
            squares.append(float(left @ left))
        return int(np.argmin(squares))


def _score_hidden_state(
    state: HiddenState, whitened: _WhitenedColumns, known: Sequence[AnyTerm]
) -> _HiddenStateScores:
    """Best sums with a hidden state, at the scales where all terms together leave least."""
    weak = whitened.weak
    scales = state.trial_scales(weak.motions[0].period)
    lows, highs = scales.min(axis=0), scales.max(axis=0)
    best = scales[whitened.best_scales_index(state, scales)]
    width = _greatest_neighbour_ratio(scales)
    for _ in range(_ROUNDS):
        grid = best * width ** np.linspace(-1.0, 1.0, _FINER)[:, None]
        for k in range(len(best)):  # one scale after the other
            scales = np.tile(best, (_FINER, 1))
            scales[:, k] = np.clip(grid[:, k], lows[k], highs[k])
            best = scales[whitened.best_scales_index(state, scales)]
        width = width ** (2.0 / (_FINER - 1))
    strained = _weak_form_with_state(weak, state, best[None])[0]
    ranked, scorer = score_subsets(strained, known, known, all_index_subsets(len(known)))
    return _HiddenStateScores(ScaledHiddenState(state, tuple(map(float, best))), ranked, scorer)


def _greatest_neighbour_ratio(scales: np.ndarray) -> np.ndarray:
    """Ratio of neighbours on the first grid, scale by scale."""
    different = [np.unique(column) for column in scales.T]
    return np.array([float((item[1:] / item[:-1]).max()) for item in different])


def _weak_form_with_state(weak: WeakForm, state: HiddenState, scales: np.ndarray) -> list[WeakForm]:
    """Weak form with the hidden state as its input, for each of the scales (k, s)."""
    values = [state.values_along_motion(motion.time, motion.smooth, scales) for motion in weak.motions]
    return [
        WeakForm(
            tuple(
                dataclasses.replace(part, motion=part.motion._replace(drive=value[k]))
                for part, value in zip(weak.parts, values, strict=True)
            )
        )
        for k in range(len(scales))
    ]


def add_hidden_state(
    candidate: CandidateEquation, hidden_state: ScaledHiddenState | None, scorer: EquationScorer
) -> CandidateEquation:
    """Candidate with its hidden state, whose scales cost what other numbers do."""
    if hidden_state is None or candidate.hidden_state is not None:
        return candidate
    count = len(hidden_state.scales)
    return dataclasses.replace(
        candidate,
        hidden_state=hidden_state,
        complexity=candidate.complexity + count,
        criterion=candidate.criterion + count * math.log(scorer.weak.sample_count),
    )


def _rescore_candidate(
    candidate: CandidateEquation, count: int, scored: _HiddenStateScores
) -> CandidateEquation:
    """Candidate with so many numbers by the common unit of misfit, with its hidden state."""
    scorer = scored.scorer
    criterion = scorer.information_criterion(scorer.squares_from_misfit(candidate.error, count), count)
    again = dataclasses.replace(candidate, criterion=criterion)
    return add_hidden_state(again, scored.hidden_state, scorer)


def _candidates_with_state(scored: _HiddenStateScores) -> list[CandidateEquation]:
    """Best sums first; one that does not hold the hidden state is one without memory."""
    candidates = [
        _rescore_candidate(candidate_from_terms(candidate), len(candidate.terms), scored)
        for candidate in scored.ranked
        if scored.hidden_state is None or any(term.has_input for term in candidate.terms)
    ]
    return sorted(candidates, key=lambda candidate: candidate.criterion)[:_RETAINED]


def _symbolic_candidates_with_state(
    scored: _HiddenStateScores, known: Sequence[AnyTerm], search: SymbolicSearch
) -> list[CandidateEquation]:
    """Candidates of a symbolic regression, with the hidden state as a variable."""
    if scored.hidden_state is None:
        return []
    terms = [item for item in known if item.has_input or item.is_speed_independent]
    candidates, _ = propose_symbolic_candidates(scored.scorer.weak, terms, search)
    return [
        _rescore_candidate(candidate, len(replace_numbers_by_symbols(candidate.expression)[1]), scored)
        for candidate in candidates
    ]


def _hidden_state_notes(groups: Sequence[Sequence[CandidateEquation]], best: int) -> tuple[str, ...]:
    """Gain by the hidden state, and others that do as well."""
    lead = groups[best][0]
    if lead.hidden_state is None:
        return ("no hidden state that was tried is worth its numbers: the law has no memory",)
    gain = groups[0][0].criterion - lead.criterion
    notes = [
        f"the force has memory: with a {lead.hidden_state.kind.name} the information criterion is "
        f"{gain:.4g} below that of the best sum without"
    ]
    alike = [
        group[0].hidden_state.kind.name
        for group in groups
        if group[0] is not lead
        and group[0].hidden_state is not None
        and group[0].criterion < lead.criterion + _CLEAR
    ]
    if alike:
        notes.append(f"the data cannot tell it from {', '.join(alike)}")
    return tuple(notes)
