"""The choice: the best candidates fitted, and the simplest of those that describe the data."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.errors import format_factor
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.structure_proposals import ProposedStructures, candidate_from_terms
from reduced_models.discovery.subset_selection import EquationScorer, normalise_columns, score_terms
from reduced_models.discovery.terms import AnyTerm, replace_numbers_by_symbols, sort_terms, structure_text

if TYPE_CHECKING:
    import sympy

_POOR = 2.0
_STRONG = 6.0
"""Difference of criteria from which evidence is strong (Kass & Raftery 1995,
doi:10.1080/01621459.1995.10476572); below it the simpler equation is chosen."""
_MOST_TRIED = 20
_PREFERRED, _MOST_PREFERRED = 0.25, 2
"""Share of the random halves from which on a structure is fitted too, and how many such at most."""
_HOPELESS = 15.0  # a criterion that is so much worse is not made good by fitting


def polish_and_choose_candidate(
    proposed: ProposedStructures,
    polish: Callable[[CandidateEquation], CandidateEquation],
    count: int,
    seed: int | None = None,
    *,
    integrated: bool = False,
) -> tuple[list[CandidateEquation], int]:
    """Fit the best candidates, and with a seed those that halves prefer; choose the simplest sound one."""
    # Of those that could be fitted, the one with the fewest numbers to which no other is strongly preferred:
    # by 6 of the criterion (Kass & Raftery 1995, doi:10.1080/01621459.1995.10476572).
    candidates, scorer = proposed.candidates, proposed.scorer
    order = sorted(candidates, key=lambda candidate_: candidate_.criterion)
    near = list[CandidateEquation]()
    for item in order:
        hopeless = item.criterion > order[0].criterion + _HOPELESS
        if len(near) < count and not hopeless and not _has_same_structure(item, near):
            near.append(item)
    if integrated:  # their noise is not known, so the simplest ones of the front are fitted
        near = pareto_front(candidates)[: count + 1] if count else []
    elif count and seed is not None:
        near += [item for item in _preferred_by_halves(order, scorer, seed) if item not in near]
    done = [polish(candidate_) for candidate_ in near]
    if count and not any(candidate_.models for candidate_ in done):
        further = [candidate_ for candidate_ in order if not _has_same_structure(candidate_, near)]
        polished = (item for item in map(polish, further[:_MOST_TRIED]) if item.models)
        done += itertools.islice(polished, 1)
    done = _add_pruned_candidates(done, polish, proposed)
    fitted = [candidate_ for candidate_ in done if candidate_.models]
    if fitted:
        best = _simplest_candidate(fitted, _solution_criteria(fitted, scorer))
    else:
        left = [*done, *order[len(done) :]]
        best = _simplest_candidate(left, [candidate_.criterion for candidate_ in left])
    shown = done if best in done else [*done, best]
    rest = [
        candidate_
        for candidate_ in pareto_front(candidates)
        if not _has_same_structure(candidate_, [*near, *shown])
    ]
    front = sorted(
        [*shown, *rest, *proposed.others], key=lambda candidate_: (candidate_.complexity, -candidate_.error)
    )
    return front, next(k for k, candidate_ in enumerate(front) if candidate_ is best)


def _add_pruned_candidates(
    done: list[CandidateEquation],
    polish: Callable[[CandidateEquation], CandidateEquation],
    proposed: ProposedStructures,
) -> list[CandidateEquation]:
    """Polished candidates, and what is left of them without the terms that may be zero."""
    candidates = list(done)
    for candidate in candidates:  # which grows: what is left may have such terms as well
        needed = _needed_terms(candidate, proposed.scorer)
        if needed:
            simpler = proposed.study.candidate(candidate_from_terms(score_terms(proposed.scorer, needed)))
            if not _has_same_structure(simpler, candidates):
                candidates.append(polish(simpler))
    return candidates


def _has_same_structure(candidate: CandidateEquation, others: Sequence[CandidateEquation]) -> bool:
    """Return true where one of some candidates is that one, or has its structure."""
    return any(other is candidate or _structure(other) == _structure(candidate) for other in others)


def _structure(candidate: CandidateEquation) -> Collection[AnyTerm] | sympy.Expr:
    if candidate.terms is None:
        return replace_numbers_by_symbols(candidate.expression)[0]
    return frozenset(candidate.terms)


def _needed_terms(candidate: CandidateEquation, scorer: EquationScorer) -> list[AnyTerm]:
    """Terms whose coefficients are surely not zero; else all but the one that is needed least."""
    rises = _rises_by_solution(candidate, scorer)
    if rises is None or candidate.model is None:
        return []
    # The coefficients of a sum are named in the order of its terms.
    intervals = [candidate.model.intervals[f"c{k}"] for k in range(len(rises))]
    sure = [term for term, (low, high) in zip(rises, intervals, strict=True) if not low <= 0.0 <= high]
    least = min(rises, key=rises.__getitem__)
    if len(sure) == len(rises) and rises[least] < _STRONG:
        return [term for term in rises if term != least]
    return sure


def _rises_by_solution(candidate: CandidateEquation, scorer: EquationScorer) -> dict[AnyTerm, float] | None:
    """Rise of the solution's criterion without each term, by its coefficient over its standard error."""
    model = candidate.model
    if model is None or not candidate.terms:
        return None
    terms, count = sort_terms(candidate.terms), len(model.parameters)
    if any(f"c{k}" not in model.covariance_names for k in range(len(terms))):
        return None
    price = scorer.information_criterion(0.0, count) - scorer.information_criterion(0.0, count - 1)
    rises = {}
    for k, term in enumerate(terms):
        index = model.covariance_names.index(f"c{k}")
        variance = float(model.covariance[index, index])
        rises[term] = model.parameters[f"c{k}"] ** 2 / max(variance, 1e-300) - price
    return rises


def _preferred_by_halves(
    order: Sequence[CandidateEquation], scorer: EquationScorer, seed: int
) -> list[CandidateEquation]:
    """Candidates that many random halves of the integrals prefer, the most frequent first."""
    sums = [candidate for candidate in order if candidate.terms]
    if len(sums) < 2:
        return []
    structures = [tuple(sort_terms(candidate.terms)) for candidate in sums if candidate.terms]
    fractions = _selection_fractions(scorer, structures, seed)
    best = np.argsort(-fractions, kind="stable")[:_MOST_PREFERRED]
    return [sums[k] for k in best if fractions[k] >= _PREFERRED]


def _simplest_candidate(candidates: list[CandidateEquation], criteria: list[float]) -> CandidateEquation:
    """One with the fewest numbers of those to which no other is strongly preferred."""
    limit = min(criteria) + _STRONG
    near = [
        (candidate, value) for candidate, value in zip(candidates, criteria, strict=True) if value <= limit
    ]
    return min(near, key=lambda pair: (_parameter_count(pair[0]), pair[1]))[0]


def _parameter_count(candidate: CandidateEquation) -> int:
    if candidate.models:  # numbers within terms, and a hidden state's, count too
        return sum(low < high for low, high in candidate.models[0].intervals.values())
    return len(replace_numbers_by_symbols(candidate.expression)[1])


def _solution_criteria(fitted: list[CandidateEquation], scorer: EquationScorer) -> list[float]:
    """Criterion with the residuals of the solutions instead of the weak ones."""
    weighing = dataclasses.replace(scorer, excess=1.0)
    squares = np.zeros(len(fitted))
    for k, motion in enumerate(scorer.weak.motions):
        models = [fit.models[k] for fit in fitted]
        residuals = np.array([model.quality.residual for model in models])
        noise = max(motion.noise * abs(models[0].height_line.scale), float(residuals.min()), 1e-300)
        squares += len(motion.time) * (residuals / noise) ** 2
    counts = [_parameter_count(candidate) for candidate in fitted]
    return [
        weighing.information_criterion(float(square), count)
        for square, count in zip(squares, counts, strict=True)
    ]


def notes_on_candidate(best: CandidateEquation, scorer: EquationScorer) -> tuple[str, ...]:
    """Doubts about the chosen equation, in plain words."""
    notes = []
    left = best.error
    if best.models:
        # The solution itself tells more than integrals with an estimate of z' in them.
        noises = [motion.noise for motion in scorer.weak.motions]
        left = max(
            model.quality.residual / (noise * abs(model.height_line.scale))
            for model, noise in zip(best.models, noises, strict=True)
        )
    if left > _POOR:
        notes.append(
            f"the chosen equation leaves {format_factor(left)} times what the record's noise would: "
            "the law is not among those searched, so read it as a summary of this record"
        )
    if best.model is None and best.note:
        notes.append(f"the chosen equation was not polished: {best.note}")
    return tuple(notes)


# A share of `_LEAST_SHARE` is then known to 0.02.
_RESAMPLES = 200
_LEAST_SHARE = 0.1
"""Least share of the resamples: a structure that wins less often is no rival."""


class StructureEvidence(NamedTuple):
    """Evidence for a structure: its terms by its criterion, and rivals by stability selection."""

    criterion_increases: dict[str, float]  # without each term
    fraction: float  # of random halves that choose it, or it with more terms
    rivals: tuple[str, ...]  # that other halves choose, the most frequent first
    refuted: tuple[tuple[str, float, float], ...] = ()  # text, fraction of halves, rise of the criterion

    @property
    def rival_note(self) -> str:
        """Structures that other halves of the data choose, and why they are not taken; empty without any."""
        notes = []
        if self.rivals:
            notes.append(
                f"the data cannot tell this structure from {' or '.join(self.rivals)}: of "
                f"{_RESAMPLES} random halves of it {100 * self.fraction:.0f} % choose it"
            )
        notes += [
            f"integrals over random halves of the record choose {text} in {100 * fraction:.0f} %, but its "
            f"solution misses the record by more (information criterion {rise:.0f} higher)"
            for text, fraction, rise in self.refuted
            if fraction > self.fraction
        ]
        return "; ".join(notes)


def weigh_structure_evidence(
    chosen: CandidateEquation,
    candidates: Sequence[CandidateEquation],
    scorer: EquationScorer,
    seed: int,
    fitted: Sequence[CandidateEquation] = (),
) -> StructureEvidence | None:
    """Weigh the terms of a chosen sum by the criterion that chose it, and rivals by stability selection."""
    # Stability selection: each random half of the integrals chooses among the structures (Meinshausen &
    # Buhlmann 2010, doi:10.1111/j.1467-9868.2010.00740.x).
    if chosen.terms is None or not chosen.terms:
        return None
    own = sort_terms(chosen.terms)
    rises = _rises_by_solution(chosen, scorer)
    if rises is None:
        total = score_terms(scorer, own).criterion
        rests = {term: [item for item in own if item != term] for term in own}
        rises = {
            term: (score_terms(scorer, rest).criterion if rest else _criterion_without_terms(scorer)) - total
            for term, rest in rests.items()
        }
    structures = [tuple(own)]
    for candidate in candidates:
        terms = None if candidate.terms is None else tuple(sort_terms(candidate.terms))
        if terms and terms not in structures:
            structures.append(terms)
    fractions = _selection_fractions(scorer, structures, seed)
    order = np.argsort(-fractions[1:], kind="stable") + 1
    worse = _criteria_above(chosen, fitted, scorer)
    # With a further term the structure holds as well: that is no other one.
    others = [k for k in order if fractions[k] >= _LEAST_SHARE and not set(structures[k]) >= set(own)]
    refuted = [k for k in others if worse.get(frozenset(structures[k]), 0.0) > _STRONG]
    fraction = sum(
        value for value, terms in zip(fractions, structures, strict=True) if set(terms) >= set(own)
    )
    return StructureEvidence(
        {term.text: rise for term, rise in rises.items()},
        float(fraction),
        tuple(structure_text(structures[k]) for k in others if k not in refuted),
        tuple(
            (structure_text(structures[k]), float(fractions[k]), worse[frozenset(structures[k])])
            for k in refuted
        ),
    )


def _criteria_above(
    chosen: CandidateEquation, fitted: Sequence[CandidateEquation], scorer: EquationScorer
) -> dict[frozenset[AnyTerm], float]:
    """Criteria of fitted sums by their terms, above that of the chosen one, by their solutions."""
    sums = [item for item in fitted if item.terms and item.models]
    if chosen not in sums:
        return {}
    criteria = _solution_criteria(sums, scorer)
    own = criteria[sums.index(chosen)]
    return {frozenset(item.terms or ()): value - own for item, value in zip(sums, criteria, strict=True)}


def _criterion_without_terms(scorer: EquationScorer) -> float:
    target = scorer.whitening @ scorer.weak.target
    return scorer.information_criterion(float(target @ target), 0)


def _selection_fractions(
    scorer: EquationScorer, structures: Sequence[tuple[AnyTerm, ...]], seed: int
) -> np.ndarray:
    """Fraction of the resamples of the white integrals in which each structure is best."""
    union = sort_terms({term for terms in structures for term in terms})
    index = {term: k for k, term in enumerate(union)}
    columns, _ = normalise_columns(scorer.whitening @ scorer.weak.term_integral_matrix(union))
    target = scorer.whitening @ scorer.weak.target
    chosen = [[index[term] for term in terms] for terms in structures]
    random = np.random.default_rng(seed)
    grams, moments, totals = [], [], []
    for _ in range(_RESAMPLES):
        half = random.permutation(len(target))[: len(target) // 2]
        matrix, vector = columns[half], target[half]
        grams.append(matrix.T @ matrix)
        moments.append(matrix.T @ vector)
        totals.append(float(vector @ vector))
    criteria = np.empty((_RESAMPLES, len(structures)))
    for size in set(map(len, chosen)):
        columns_of_size = [k for k, numbers in enumerate(chosen) if len(numbers) == size]
        subsets = np.array([chosen[k] for k in columns_of_size])
        gains = _gains_of_subsets(np.array(grams), np.array(moments), subsets)
        squares = np.array(totals)[:, None] - gains
        criteria[:, columns_of_size] = [
            [scorer.information_criterion(value, size) for value in row] for row in squares
        ]
    wins = np.bincount(criteria.argmin(axis=1), minlength=len(structures))
    return np.asarray(wins / _RESAMPLES)


def _gains_of_subsets(grams: np.ndarray, moments: np.ndarray, subsets: np.ndarray) -> np.ndarray:
    """Decrease of each half's sum of squares by each of some subsets of one size (h, s)."""
    inner = grams[:, subsets[:, :, None], subsets[:, None, :]] + 1e-12 * np.eye(subsets.shape[1])
    sides = moments[:, subsets]
    solved = np.linalg.solve(inner, sides[..., None])
    return np.asarray((sides[:, :, None, :] @ solved)[..., 0, 0])
