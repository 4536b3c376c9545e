"""The last steps of every discovery method: fit the candidate equations to the records and choose one."""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, TimeBudgetError, format_factor
from reduced_models.discovery.parametric_terms import ParametricTerms
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.structure_proposals import ProposedStructures, candidate_from_terms
from reduced_models.discovery.subset_selection import (
    EquationScorer,
    normalised_columns_and_lengths,
    score_terms,
)
from reduced_models.discovery.terms import (
    AnyTerm,
    CustomTerm,
    Term,
    expression_node_count,
    expression_text,
    expression_with_symbols_and_their_numbers,
    sort_terms,
    state_symbols,
    structure_text,
)
from reduced_models.fitting.fit import fit
from reduced_models.fitting.parameter import Parameter
from reduced_models.fitting.problem import FitOptions
from reduced_models.fitting.start_values import StartDrawsNearValues
from reduced_models.laws.law import HeightLine, Law
from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    import sympy


_POOR_FIT = 2.0  # residual over the record's noise
_STRONG = 6.0
"""Difference of information criteria above which evidence is strong (Kass & Raftery 1995,
doi:10.1080/01621459.1995.10476572); if the difference is smaller, the simpler equation is chosen."""
_EQUAL = 0.1  # difference of criteria between sums that are the same function along the record
_MAXIMUM_FURTHER_FITS = 20
_PREFERRED_FRACTION, _MAXIMUM_PREFERRED = 0.25, 2
"""A structure that is best on at least the fraction `_PREFERRED_FRACTION` of random halves of the data is
also fitted. At most `_MAXIMUM_PREFERRED` structures are added in this way."""
_HOPELESS_DIFFERENCE = 15.0  # a larger difference of criteria is not removed by a fit


def fit_candidates_and_choose_index(
    proposed: ProposedStructures,
    polish: Callable[[CandidateEquation], CandidateEquation],
    count: int,
    seed: int | None = None,
    *,
    integrated: bool = False,
) -> tuple[list[CandidateEquation], int]:
    """Fit candidates, choose the simplest good fit; return all candidates and the index of the choice."""
    # The choice is the fitted candidate with the fewest parameters to which no other is strongly preferred,
    # i.e. by 6 of the criterion (Kass & Raftery 1995, doi:10.1080/01621459.1995.10476572).
    candidates, scorer = proposed.candidates, proposed.scorer
    order = sorted(candidates, key=lambda candidate_: candidate_.criterion)
    near = list[CandidateEquation]()
    for item in order:
        hopeless = item.criterion > order[0].criterion + _HOPELESS_DIFFERENCE
        if len(near) < count and not hopeless and not _has_same_structure(item, near):
            near.append(item)
    if integrated:  # the noise is unknown, so the simplest candidates of the front are fitted
        near = pareto_front(candidates)[: count + 1] if count else []
    elif count and seed is not None:
        near += [
            item for item in _candidates_preferred_by_random_halves(order, scorer, seed) if item not in near
        ]
    done = [polish(candidate_) for candidate_ in near]
    if count and not any(candidate_.models for candidate_ in done):
        further = [candidate_ for candidate_ in order if not _has_same_structure(candidate_, near)]
        polished = (item for item in map(polish, further[:_MAXIMUM_FURTHER_FITS]) if item.models)
        done += itertools.islice(polished, 1)
    done = _fit_and_add_pruned_candidates(done, polish, proposed)
    fitted = _drop_candidates_with_unneeded_terms(
        [candidate_ for candidate_ in done if candidate_.models], scorer
    )
    if fitted:
        best = _simplest_candidate(fitted, _information_criteria_of_solutions(fitted, scorer))
    else:
        unfitted = [*done, *order[len(done) :]]
        best = _simplest_candidate(unfitted, [candidate_.criterion for candidate_ in unfitted])
    shown = done if best in done else [*done, best]
    rest = [
        candidate_
        for candidate_ in pareto_front(candidates)
        if not _has_same_structure(candidate_, [*near, *shown])
    ]
    front = sorted(
        [*shown, *rest, *proposed.candidates_of_other_studies],
        key=lambda candidate_: (candidate_.complexity, -candidate_.error),
    )
    return front, next(k for k, candidate_ in enumerate(front) if candidate_ is best)


def _fit_and_add_pruned_candidates(
    done: list[CandidateEquation],
    polish: Callable[[CandidateEquation], CandidateEquation],
    proposed: ProposedStructures,
) -> list[CandidateEquation]:
    """Fit candidates also without the terms that may be zero, and append these smaller candidates."""
    candidates = list(done)
    for candidate in candidates:  # the list grows: a pruned candidate may be pruned further
        needed = _terms_needed_by_solution(candidate, proposed.scorer)
        if needed:
            simpler = proposed.study.candidate_with_full_criterion(
                candidate_from_terms(score_terms(proposed.scorer, needed))
            )
            if not _has_same_structure(simpler, candidates):
                candidates.append(polish(simpler))
    return candidates


def _drop_candidates_with_unneeded_terms(
    fitted: list[CandidateEquation], scorer: EquationScorer
) -> list[CandidateEquation]:
    """Drop candidates with a term that the fit does not need; keep all if no candidate would remain."""
    # Errors of a solver are smooth: further terms follow them, but by intervals that allow for correlated
    # residuals their coefficients are not determined.
    rises = [_criterion_rises_without_each_term(item, scorer) for item in fitted]
    sound = [
        item
        for item, rise in zip(fitted, rises, strict=True)
        if rise is not None and min(rise.values()) >= _STRONG
    ]
    unknown = [item for item, rise in zip(fitted, rises, strict=True) if rise is None]
    return [*sound, *unknown] if sound else fitted


def _has_same_structure(candidate: CandidateEquation, others: Sequence[CandidateEquation]) -> bool:
    """Return whether a list contains this candidate or another with the same structure."""
    return any(
        other is candidate or _structure_without_numbers(other) == _structure_without_numbers(candidate)
        for other in others
    )


def _structure_without_numbers(candidate: CandidateEquation) -> Collection[AnyTerm] | sympy.Expr:
    if candidate.terms is None:
        return expression_with_symbols_and_their_numbers(candidate.expression)[0]
    return frozenset(candidate.terms)


def _terms_needed_by_solution(candidate: CandidateEquation, scorer: EquationScorer) -> list[AnyTerm]:
    """Return the terms whose 95 % intervals exclude zero, or all except a term with weak evidence."""
    rises = _criterion_rises_without_each_term(candidate, scorer)
    if rises is None or candidate.model is None:
        return []
    # Coefficients are numbered in the order of the terms.
    intervals = [candidate.model.intervals[f"c{k}"] for k in range(len(rises))]
    sure = [term for term, (low, high) in zip(rises, intervals, strict=True) if not low <= 0.0 <= high]
    weakest = min(rises, key=rises.__getitem__)
    if len(sure) == len(rises) and rises[weakest] < _STRONG:
        return [term for term in rises if term != weakest]
    return sure


def _criterion_rises_without_each_term(
    candidate: CandidateEquation, scorer: EquationScorer
) -> dict[AnyTerm, float] | None:
    """Return, for each term, the criterion's rise if the term is removed, from the term's standard error."""
    model = candidate.model
    if model is None or not candidate.terms:
        return None
    terms, count = sort_terms(candidate.terms), len(model.parameters)
    if any(f"c{k}" not in model.covariance_names for k in range(len(terms))):
        return None
    noise = scorer.weak.motions[0].noise * abs(model.height_line.scale)
    squares = (model.quality.residual / noise) ** 2
    weighing = dataclasses.replace(scorer, excess=max(1.0, squares))
    penalty = weighing.information_criterion(0.0, count) - weighing.information_criterion(0.0, count - 1)
    rises = {}
    for k, term in enumerate(terms):
        index = model.covariance_names.index(f"c{k}")
        variance = float(model.covariance[index, index])
        ratio = model.parameters[f"c{k}"] ** 2 / max(variance, 1e-300)
        rises[term] = ratio * min(1.0, squares) - penalty
    return rises


def _candidates_preferred_by_random_halves(
    order: Sequence[CandidateEquation], scorer: EquationScorer, seed: int
) -> list[CandidateEquation]:
    """Return candidates that fit many random halves of the integrals best, the most frequent first."""
    sums = [candidate for candidate in order if candidate.terms]
    if len(sums) < 2:
        return []
    structures = [tuple(sort_terms(candidate.terms)) for candidate in sums if candidate.terms]
    fractions = _selection_fractions(scorer, structures, seed)
    best = np.argsort(-fractions, kind="stable")[:_MAXIMUM_PREFERRED]
    return [sums[k] for k in best if fractions[k] >= _PREFERRED_FRACTION]


def _simplest_candidate(candidates: list[CandidateEquation], criteria: list[float]) -> CandidateEquation:
    """Return the candidate with the fewest parameters whose criterion is at most 6 above the lowest."""
    limit = min(criteria) + _STRONG
    near = [
        (candidate, value) for candidate, value in zip(candidates, criteria, strict=True) if value <= limit
    ]
    fewest = min(_parameter_count(candidate) for candidate, _ in near)
    near = [pair for pair in near if _parameter_count(pair[0]) == fewest]
    # Of equal candidates the one with the shorter text, such as 1 for sign(z') if z' keeps its sign.
    best = min(value for _, value in near)
    equals = [candidate for candidate, value in near if value < best + _EQUAL]
    return min(equals, key=lambda candidate: candidate.complexity)


def _parameter_count(candidate: CandidateEquation) -> int:
    if candidate.models:  # the count includes parameters inside terms and of a hidden state
        return sum(low < high for low, high in candidate.models[0].intervals.values())
    return len(expression_with_symbols_and_their_numbers(candidate.expression)[1])


def _information_criteria_of_solutions(
    fitted: list[CandidateEquation], scorer: EquationScorer
) -> list[float]:
    """Return each candidate's information criterion, from residuals of its solutions (not the weak form)."""
    squares = np.zeros(len(fitted))
    for k, motion in enumerate(scorer.weak.motions):
        models = [fit.models[k] for fit in fitted]
        residuals = np.array([model.quality.residual for model in models])
        noise = motion.noise * abs(models[0].height_line.scale)
        squares += len(motion.time) * (residuals / noise) ** 2
    # If even the best solution has a residual above the noise, this residual is the unit.
    excess = max(1.0, float(squares.min()) / scorer.weak.sample_count)
    weighing = dataclasses.replace(scorer, excess=excess)
    counts = [_parameter_count(candidate) for candidate in fitted]
    return [
        weighing.information_criterion(float(square), count)
        for square, count in zip(squares, counts, strict=True)
    ]


def notes_on_candidate(best: CandidateEquation, scorer: EquationScorer) -> tuple[str, ...]:
    """Return cautions about the chosen equation, in plain words."""
    notes = []
    residual_ratio = best.error
    if best.models:
        # The solution is a stricter test than integrals that contain an estimate of z'.
        noises = [motion.noise for motion in scorer.weak.motions]
        residual_ratio = max(
            model.quality.residual / (noise * abs(model.height_line.scale))
            for model, noise in zip(best.models, noises, strict=True)
        )
    if residual_ratio > _POOR_FIT:
        notes.append(
            f"the residual of the chosen equation is {format_factor(residual_ratio)} times the record's "
            "noise, so the true law is not among the candidates; regard the equation as a summary of the "
            "record"
        )
    if best.model is None and best.note:
        notes.append(f"the chosen equation was not fitted to the record: {best.note}")
    return tuple(notes)


# A fraction of `_MINIMUM_FRACTION` then has a standard error of 0.02.
_RESAMPLES = 200
_MINIMUM_FRACTION = 0.1
"""A structure competes with the chosen one if it fits at least this fraction of the random halves best."""


class StructureEvidence(NamedTuple):
    """Evidence for a structure: rise of the criterion without each term, and competing structures."""

    criterion_increases: dict[str, float]  # rise of the criterion without each term
    fraction: float  # fraction of the random halves that choose the structure, with or without further terms
    rivals: tuple[str, ...]  # structures that other halves choose, the most frequent first
    refuted: tuple[tuple[str, float, float], ...] = ()  # text, fraction of halves, rise of the criterion

    @property
    def rival_structures_text(self) -> str:
        """Name competing structures, and rejected ones with the reason; empty if there are none."""
        notes = []
        if self.rivals:
            notes.append(
                f"the data cannot distinguish this structure from {' or '.join(self.rivals)}: "
                f"{100 * self.fraction:.0f} % of {_RESAMPLES} random halves of the data choose this structure"
            )
        notes += [
            f"{100 * fraction:.0f} % of random halves of the record's integrals choose {text}, but its "
            f"solution fits the record worse (information criterion {rise:.0f} higher)"
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
    """Return the evidence for each term of the chosen sum, and for the sums that compete with it."""
    # Stability selection: each random half of the integrals votes for one structure (Meinshausen &
    # Buhlmann 2010, doi:10.1111/j.1467-9868.2010.00740.x).
    if chosen.terms is None or not chosen.terms:
        return None
    own = sort_terms(chosen.terms)
    rises = _criterion_rises_without_each_term(chosen, scorer)
    if rises is None:
        total = score_terms(scorer, own).criterion
        rests = {term: [item for item in own if item != term] for term in own}
        target = scorer.whitening @ scorer.weak.target
        without = scorer.information_criterion(float(target @ target), 0)
        rises = {
            term: (score_terms(scorer, rest).criterion if rest else without) - total
            for term, rest in rests.items()
        }
    structures = [tuple(own)]
    for candidate in candidates:
        terms = None if candidate.terms is None else tuple(sort_terms(candidate.terms))
        if terms and terms not in structures:
            structures.append(terms)
    fractions = _selection_fractions(scorer, structures, seed)
    order = np.argsort(-fractions[1:], kind="stable") + 1
    worse = _criteria_relative_to_chosen(chosen, fitted, scorer)
    # A structure that contains all chosen terms confirms them, so it is not a rival.
    others = [k for k in order if fractions[k] >= _MINIMUM_FRACTION and not set(structures[k]) >= set(own)]
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


def _criteria_relative_to_chosen(
    chosen: CandidateEquation, fitted: Sequence[CandidateEquation], scorer: EquationScorer
) -> dict[frozenset[AnyTerm], float]:
    """Return, by its terms, each fitted sum's criterion minus the criterion of the chosen sum."""
    sums = [item for item in fitted if item.terms and item.models]
    if chosen not in sums:
        return {}
    criteria = _information_criteria_of_solutions(sums, scorer)
    own = criteria[sums.index(chosen)]
    return {frozenset(item.terms or ()): value - own for item, value in zip(sums, criteria, strict=True)}


def _selection_fractions(
    scorer: EquationScorer, structures: Sequence[tuple[AnyTerm, ...]], seed: int
) -> np.ndarray:
    """Return the fraction of random halves of the whitened integrals that each structure fits best."""
    union = sort_terms({term for terms in structures for term in terms})
    index = {term: k for k, term in enumerate(union)}
    columns, _ = normalised_columns_and_lengths(scorer.whitening @ scorer.weak.term_integral_matrix(union))
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
        gains = _square_sum_decreases_of_subsets(np.array(grams), np.array(moments), subsets)
        squares = np.array(totals)[:, None] - gains
        criteria[:, columns_of_size] = [
            [scorer.information_criterion(value, size) for value in row] for row in squares
        ]
    wins = np.bincount(criteria.argmin(axis=1), minlength=len(structures))
    return np.asarray(wins / _RESAMPLES)


def _square_sum_decreases_of_subsets(
    grams: np.ndarray, moments: np.ndarray, subsets: np.ndarray
) -> np.ndarray:
    """Return by how much each subset s of terms decreases the sum of squares of each data half h: (h, s)."""
    inner = grams[:, subsets[:, :, None], subsets[:, None, :]] + 1e-12 * np.eye(subsets.shape[1])
    sides = moments[:, subsets]
    solved = np.linalg.solve(inner, sides[..., None])
    return np.asarray((sides[:, :, None, :] @ solved)[..., 0, 0])


STARTS = 4
_MAXIMUM_PARAMETERS = 12
_STEEPNESS = 100.0  # steepness of the tanh that replaces sign(z'), relative to 1/(typical speed)
# Steps per step of a smooth law, as `reduced_models.laws.coulomb` needs for its tanh.
_RESOLUTION = 4
_MEMORY_RESOLUTION = 2  # for laws with a hidden state
_LONGEST_NAME = 80  # characters
_AS_IT_IS = Sensor("force", gain=1.0)
_NONE_OPEN = ParametricTerms()


def fit_candidate_numbers(
    candidate: CandidateEquation,
    records: Sequence[PistonRecord],
    line: HeightLine,
    column: str | None = None,
    seed: int = 0,
    open_terms: ParametricTerms = _NONE_OPEN,
) -> CandidateEquation:
    """Fit the numbers of a candidate to the records; return it with models, or with a note on the failure."""
    template, values = open_terms.expression_with_symbols_and_values(candidate)
    if len(values) > _MAXIMUM_PARAMETERS:
        return dataclasses.replace(
            candidate,
            note=f"it has {len(values)} parameters, but a fit can have at most {_MAXIMUM_PARAMETERS}",
        )
    hidden_state = candidate.hidden_state
    if hidden_state is not None:
        values |= dict(zip(hidden_state.kind.scales, hidden_state.scales, strict=True))
    moving = candidate.left_side == "z''"
    measured = _AS_IT_IS if candidate.left_side == "force" else None
    given = {name: Parameter(value, fixed=True) for name, value in line._asdict().items()}
    if not moving:
        given = {name: Parameter(value) for name, value in values.items()}
    elif line == HeightLine():
        given = {}
    try:
        law = law_of_candidate(candidate, template, values, records, line, column)
        with warnings.catch_warnings(action="ignore"):  # the model keeps them as notes
            models = fit(
                records,
                law,
                parameters=given,
                starts=STARTS,
                test_fraction=0.0,
                seed=seed,
                options=FitOptions(measured=measured),
            )
    except TimeBudgetError:
        raise
    except GranularError as error:
        return dataclasses.replace(candidate, note=str(error))
    numbers = models[0].parameters
    expression = open_terms.expression_with_fitted_values(candidate, template, numbers)
    nodes = expression_node_count(expression)
    if hidden_state is not None:
        nodes += len(hidden_state.scales)
        hidden_state = hidden_state._replace(scales=tuple(numbers[name] for name in hidden_state.kind.scales))
    return dataclasses.replace(
        candidate, expression=expression, complexity=nodes, models=models, hidden_state=hidden_state
    )


def law_of_candidate(
    candidate: CandidateEquation,
    template: sympy.Expr,
    values: dict[str, float],
    records: Sequence[PistonRecord],
    line: HeightLine,
    column: str | None = None,
) -> Law:
    """Turn a candidate into a law whose numbers are parameters with start values; ``line`` is in m."""
    import sympy

    z, v, u = state_symbols()
    moving, hidden_state = candidate.left_side == "z''", candidate.hidden_state
    if moving:
        template = replace_sign_by_tanh(template, records, line)
    elif line != HeightLine():
        template = template.xreplace({z: line.coordinate(z), v: v / line.scale})
    if column is not None:
        template = template.xreplace({u: sympy.Symbol(column)})
    inputs = (column,) if column is not None and template.has(sympy.Symbol(column)) else ()
    equation, positive = f"{candidate.left_side} = {expression_text(template)}", tuple[str, ...]()
    resolution = _RESOLUTION if moving and template.has(sympy.tanh) else 1
    if hidden_state is not None:
        equation = hidden_state.kind.substitute_into(equation)
        positive = hidden_state.kind.scales
        resolution = max(_MEMORY_RESOLUTION, resolution)
    if moving and line != HeightLine():
        # Shift and scale are parameters, so that similar records share compiled code.
        equation += "; height = shift + scale*z"
        values = values | line._asdict()
    return Law(
        name=compose_law_name_from_terms(candidate),
        equation=equation,
        start=StartDrawsNearValues(values),
        positive=positive,
        source="discovered in the record",
        inputs=inputs,
        resolution=resolution,
    )


def compose_law_name_from_terms(candidate: CandidateEquation) -> str:
    """Compose the name of a candidate's law from its terms, such as "viscous + softening"."""
    terms = candidate.terms
    if (
        candidate.left_side == "force"
        and sum(value for term, value in (terms or {}).items() if not term.is_speed_independent) > 0
    ):
        # Damping is positive along the velocity in an equation for the force, negative in one for z''.
        terms = {term: -value for term, value in (terms or {}).items()}
    if candidate.hidden_state is not None:
        terms = {term: value for term, value in (terms or {}).items() if not term.has_input}
        words = [word for word in (describe_law_from_terms(terms), candidate.hidden_state.kind.name) if word]
        return " + ".join(words)
    name = describe_law_from_terms(terms) if terms else ""
    if not name or len(name) > _LONGEST_NAME:
        _, numbers = expression_with_symbols_and_their_numbers(candidate.expression)
        return f"discovered formula with {len(numbers)} parameters"
    return name


_BY_SPEED = {1: "viscous", 2: "quadratic drag", 3: "cubic drag"}


def describe_law_from_terms(terms: Mapping[AnyTerm, float]) -> str:
    """Describe a law in engineering terms, from the terms of z'' and their coefficients."""
    others = [term for term in sort_terms(terms) if not _is_spring_term(term)]
    others.sort(key=lambda term: isinstance(term, CustomTerm) or abs(term.speed - 1))
    words = [_damping_term_text(term, terms[term]) for term in others]
    springs = {
        term.power: value for term, value in terms.items() if isinstance(term, Term) and _is_spring_term(term)
    }
    return " + ".join(dict.fromkeys([*words, *_spring_term_texts(springs)]))


def _is_spring_term(term: AnyTerm) -> bool:
    return isinstance(term, Term) and term.is_speed_independent and not term.has_input


def _damping_term_text(term: AnyTerm, coefficient: float) -> str:
    if isinstance(term, CustomTerm) or term.has_input or not term.odd or term.speed > max(_BY_SPEED):
        return term.text
    word = _BY_SPEED.get(term.speed, "dry friction")
    if term.power:
        return f"{word} by {Term(term.power).text}"
    return word if coefficient < 0.0 else f"negative {word}"


def _spring_term_texts(springs: Mapping[int, float]) -> list[str]:
    """Describe the spring from the coefficients of powers of z; empty without a spring."""
    linear, curved = springs.get(1, 0.0), {power: value for power, value in springs.items() if power > 1}
    if not curved:
        return ["linear spring"] if linear else []
    if any(power % 2 == 0 for power in curved):
        return ["asymmetric spring"]
    stiffer = curved[max(curved)] < 0.0
    if linear > 0.0:
        return ["two wells" if stiffer else "unstable spring"]
    return ["hardening" if stiffer else "softening"]


def replace_sign_by_tanh(
    template: sympy.Expr, records: Sequence[PistonRecord], line: HeightLine
) -> sympy.Expr:
    """Replace sign(z'), at which solvers fail, by a steep tanh(z') in an expression; ``line`` is in m."""
    import sympy

    _, v, _ = state_symbols()
    fastest = max(float(np.gradient(record.height, record.time).std()) for record in records)
    speed = fastest / abs(line.scale)
    # Rounded to a power of ten, so that similar records share compiled code.
    steepness = 10.0 ** round(math.log10(_STEEPNESS / speed))
    return template.subs(sympy.sign(v), sympy.tanh(sympy.Float(steepness, 4) * v))
