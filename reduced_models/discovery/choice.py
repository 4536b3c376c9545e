"""The choice: the best candidates fitted, and the simplest of those that describe the data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from granular.shared.messages import times
from reduced_models.discovery.polishing import parametrised
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.selection import Judge, weighed
from reduced_models.discovery.structures import candidate_of
from reduced_models.discovery.terms import AnyTerm, in_order

_POOR = 2.0
_STRONG = 6.0
"""Difference of criteria from which evidence is strong (Kass & Raftery 1995,
doi:10.1080/01621459.1995.10476572); below it the simpler equation is chosen."""
_MOST_TRIED = 20
_HOPELESS = 15.0  # a criterion that is so much worse is not made good by fitting


def polished_front(
    candidates: list[CandidateEquation],
    polish: Callable[[CandidateEquation], CandidateEquation],
    count: int,
    judge: Judge,
) -> tuple[list[CandidateEquation], int]:
    """The Pareto front, with all polished candidates, and the place of the chosen one."""
    order = sorted(candidates, key=lambda one: one.criterion)
    near = [one for one in order if one.criterion <= order[0].criterion + _HOPELESS][:count]
    done = [polish(one) for one in near]
    if count and not any(one.models for one in done):
        done += _first_with_model([one for one in order if not _is_among(one, near)], polish)
    done = _with_simpler_ones(done, polish, judge)
    fitted = [one for one in done if one.models]
    if fitted:
        best = _simplest(fitted, _solution_criteria(fitted, judge))
    else:
        left = [*done, *order[len(done) :]]
        best = _simplest(left, [one.criterion for one in left])
    shown = done if best in done else [*done, best]
    rest = [one for one in pareto_front(candidates) if not _is_among(one, [*near, *shown])]
    front = sorted([*shown, *rest], key=lambda one: (one.complexity, -one.error))
    return front, next(k for k, one in enumerate(front) if one is best)


def _first_with_model(
    order: Sequence[CandidateEquation], polish: Callable[[CandidateEquation], CandidateEquation]
) -> list[CandidateEquation]:
    """The best of those that come next which can be polished; none where none of many can."""
    for one in order[:_MOST_TRIED]:
        found = polish(one)
        if found.models:
            return [found]
    return []


def _with_simpler_ones(
    done: list[CandidateEquation],
    polish: Callable[[CandidateEquation], CandidateEquation],
    judge: Judge,
) -> list[CandidateEquation]:
    """Polished candidates, and what is left of them without the terms that may be zero."""
    found = list(done)
    for one in found:  # which grows: what is left may have such terms as well
        needed = _needed_terms(one)
        if needed:
            simpler = candidate_of(weighed(judge, needed))
            if not _is_among(simpler, found):
                found.append(polish(simpler))
    return found


def _is_among(candidate: CandidateEquation, others: Sequence[CandidateEquation]) -> bool:
    """Whether one of some candidates is that one, or has its structure."""
    terms = candidate.terms
    return any(
        one is candidate
        or (terms is not None and one.terms is not None and set(one.terms) == set(terms))
        for one in others
    )


def _needed_terms(candidate: CandidateEquation) -> list[AnyTerm]:
    """The terms whose coefficients' intervals leave out zero."""
    if candidate.model is None or candidate.terms is None:
        return []
    # The coefficients of a sum are named in the order of its terms.
    intervals = [candidate.model.intervals[f"c{k}"] for k in range(len(candidate.terms))]
    terms = zip(in_order(candidate.terms), intervals, strict=True)
    return [term for term, (low, high) in terms if not low <= 0.0 <= high]


def _simplest(candidates: list[CandidateEquation], criteria: list[float]) -> CandidateEquation:
    """The one with the fewest numbers of those to which no other is strongly preferred."""
    limit = min(criteria) + _STRONG
    near = [(one, value) for one, value in zip(candidates, criteria, strict=True) if value <= limit]
    return min(near, key=lambda pair: (_numbers(pair[0]), pair[1]))[0]


def _numbers(candidate: CandidateEquation) -> int:
    return len(parametrised(candidate.expression)[1])


def _solution_criteria(fitted: list[CandidateEquation], judge: Judge) -> list[float]:
    """The criterion with the residuals of the solutions instead of the weak ones."""
    weighing = dataclasses.replace(judge, excess=1.0)
    squares = np.zeros(len(fitted))
    for k, motion in enumerate(judge.weak.motions):
        models = [one.models[k] for one in fitted]
        residuals = np.array([model.quality.residual for model in models])
        noise = max(motion.noise * abs(models[0].map.scale), float(residuals.min()), 1e-300)
        squares += len(motion.time) * (residuals / noise) ** 2
    counts = [len(one.models[0].parameters) for one in fitted]
    return [
        weighing.criterion(float(each), count) for each, count in zip(squares, counts, strict=True)
    ]


def notes_on(best: CandidateEquation, judge: Judge) -> tuple[str, ...]:
    notes = []
    left = best.error
    if best.models:
        # The solution itself tells more than integrals with an estimate of z' in them.
        noises = [motion.noise for motion in judge.weak.motions]
        left = max(
            model.quality.residual / (noise * abs(model.map.scale))
            for model, noise in zip(best.models, noises, strict=True)
        )
    if left > _POOR:
        notes.append(
            f"the chosen equation leaves {times(left)} times what the record's noise would: the "
            "law is not among those searched, so read it as a summary of this record"
        )
    if best.model is None and best.note:
        notes.append(f"the chosen equation was not polished: {best.note}")
    notes += [note for model in best.models for note in model.notes]
    return tuple(dict.fromkeys(notes))
