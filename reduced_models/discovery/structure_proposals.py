"""Candidate structures: sparse sums of terms, and expressions of symbolic regressions."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import import_extra
from reduced_models.discovery.hidden_states import ScaledHiddenState
from reduced_models.discovery.parametric_terms import ParametricTerms
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.subset_selection import (
    MOST_TERMS,
    EquationScorer,
    ScoredTerms,
    all_index_subsets,
    eliminate_backward,
    group_subsets_by_size,
    score_again,
    score_subsets,
    scorers_in_common_unit,
)
from reduced_models.discovery.symbolic_search import (
    search_expressions_with_operon,
    search_expressions_with_pysr,
)
from reduced_models.discovery.terms import (
    AnyTerm,
    CustomTerm,
    MotionState,
    complexity,
    linear_combination,
    sort_terms,
    split_terms,
    state_symbols,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy


_THRESHOLDS = np.geomspace(1e-3, 0.5, 24)  # of a term's share, over the size of z''


def find_supports_with_pysindy(
    motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm]
) -> list[list[int]]:
    """Find the terms, by their indices, that PySINDy keeps at each of its thresholds."""
    # As in PySINDy's guide: states (z, z') with their derivatives, inputs, the terms as a library of its own
    # making, sequentially thresholded least squares (Brunton, Proctor & Kutz 2016,
    # doi:10.1073/pnas.1517384113), whose threshold is scanned.
    pysindy = import_extra("pysindy", "method 'pysindy'", "discover")
    inner = [motion.inner for motion in motions]
    data = {
        "x": [np.stack([motion.smooth, motion.velocity], axis=1) for motion in inner],
        "t": [motion.time for motion in inner],
        "x_dot": [np.stack([motion.velocity, motion.acceleration], axis=1) for motion in inner],
        "u": [np.stack([_drive(motion), motion.time], axis=1) for motion in inner],
    }
    library = pysindy.CustomLibrary([_feature(term) for term in terms], interaction_only=True)
    size = float(np.linalg.norm(np.concatenate([motion.acceleration for motion in inner])))
    supports = []
    for threshold in size * _THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-8, normalize_columns=True)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
        with warnings.catch_warnings(action="ignore"):  # that a high threshold leaves nothing
            model.fit(**data)
        supports.append(np.flatnonzero(model.coefficients()[1]).tolist())
    return supports


def _drive(motion: SmoothedMotion) -> np.ndarray:
    return np.zeros_like(motion.time) if motion.drive is None else motion.drive


def _feature(term: AnyTerm) -> Callable[..., np.ndarray]:
    # PySINDy counts the arguments.
    return lambda z, v, u, t: term.values(MotionState(*map(np.asarray, (z, v, u, t))))


_MOST_POINTS = 500  # of a symbolic regression
_MOST_UNION = 120


class SymbolicSearch(NamedTuple):
    """A symbolic regression by one of the programs for it."""

    method: str
    functions: tuple[str, ...] = ()
    effort: float = 1.0  # times the usual length of the search
    seed: int = 0

    def find_expressions(
        self, inputs: Mapping[str, np.ndarray], target: Float[np.ndarray, "n"], noise: float
    ) -> list[sympy.Expr]:
        """Find expressions for a target by symbolic regression."""
        find = search_expressions_with_pysr if self.method == "pysr" else search_expressions_with_operon
        return find(inputs, target, noise, self.functions, self.effort, self.seed)


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """The integrals of some motions, and the terms that equations for them are made of."""

    weak: WeakForm
    terms: tuple[AnyTerm, ...]
    left_side: str = "z''"  # or "force", or "height" for a formula of the time
    hidden_state: ScaledHiddenState | None = None  # that the terms have as their input
    open_terms: ParametricTerms = dataclasses.field(default_factory=ParametricTerms)

    def candidate(self, candidate: CandidateEquation) -> CandidateEquation:
        """Candidate for these motions: numbers in its terms and its hidden state cost what others do."""
        scales = 0 if self.hidden_state is None else len(self.hidden_state.scales)
        count = scales + len(self.open_terms.inner_parameters(candidate))
        return dataclasses.replace(
            candidate,
            hidden_state=self.hidden_state,
            left_side=self.left_side,
            complexity=candidate.complexity + scales,
            criterion=candidate.criterion + count * math.log(self.weak.sample_count),
        )


class ProposedStructures(NamedTuple):
    """Candidate equations, what scores them, and the best sums of each study."""

    candidates: list[CandidateEquation]
    scorer: EquationScorer
    study: Study  # of the candidates: the one with the best sum
    groups: Sequence[Sequence[CandidateEquation]] = ()

    @property
    def others(self) -> list[CandidateEquation]:
        """Sums of other studies on the common Pareto front, a list of CandidateEquation."""
        front = pareto_front([item for group in self.groups for item in group])
        return [item for item in front if item.hidden_state is not self.study.hidden_state]


def propose_structures(
    studies: Sequence[Study], method: str, search: SymbolicSearch | None
) -> ProposedStructures:
    """Propose sums of terms and expressions of symbolic regression, all scored alike."""
    # Of several studies sums of terms choose one, and symbolic regression goes on with that.
    groups, scorers = list[list[CandidateEquation]](), list[EquationScorer]()
    if search is None or len(studies) > 1:
        scored = [
            score_subsets(study.weak, study.terms, study.terms, _sparse_subsets(study, method))
            for study in studies
        ]
        scorers = scorers_in_common_unit([scorer for _, scorer in scored])
        groups = [
            _candidates_of_sums(score_again(ranked, scorer), study)
            for (ranked, _), study, scorer in zip(scored, studies, scorers, strict=True)
        ]
    best = min(range(len(groups)), key=lambda k: groups[k][0].criterion, default=0)
    study = studies[best]
    candidates = list(groups[best]) if groups and method != "operon" else []
    if search is not None:
        subsets = [] if groups or method == "operon" else _sparse_subsets(study, method)
        excess = scorers[best].excess if groups else 1.0 if study.left_side == "height" else None
        expressions, scorer = propose_symbolic_candidates(study, search, subsets, excess)
        candidates += map(study.candidate, expressions)
        scorers = scorers or [scorer]
    return ProposedStructures(candidates, scorers[best], study, groups)


def _sparse_subsets(study: Study, method: str) -> list[np.ndarray]:
    """Subsets of the terms that a sparse regression proposes."""
    if study.left_side == "height":
        return []
    if method != "pysindy":
        return all_index_subsets(len(study.terms))
    supports = find_supports_with_pysindy(study.weak.motions, study.terms)
    return _add_eliminated_supports(study.weak, study.terms, supports) or all_index_subsets(1)


def _candidates_of_sums(ranked: Sequence[ScoredTerms], study: Study) -> list[CandidateEquation]:
    """Candidates of sums, the best one first; one without the hidden state is one without memory."""
    candidates = [
        study.candidate(candidate_from_terms(item))
        for item in ranked
        if study.hidden_state is None or any(term.has_input for term in item.terms)
    ]
    return sorted(candidates, key=lambda candidate: candidate.criterion)


def _add_eliminated_supports(
    weak: WeakForm, terms: Sequence[AnyTerm], supports: Sequence[Sequence[int]]
) -> list[np.ndarray]:
    """Supports, and all that backward elimination makes of them."""
    whitening = weak.whitening_matrix((), np.zeros(0))
    matrix, target = whitening @ weak.term_integral_matrix(terms), whitening @ weak.target
    paths = (path for support in supports if support for path in eliminate_backward(matrix, target, support))
    return group_subsets_by_size(paths)


def propose_symbolic_candidates(
    study: Study, search: SymbolicSearch, subsets: Sequence[np.ndarray] = (), excess: float | None = None
) -> tuple[list[CandidateEquation], EquationScorer]:
    """Propose expressions of a symbolic regression, and what each is without some of its terms."""
    weak, terms = study.weak, study.terms
    expressions = _find_motion_expressions(study, search)
    sums = [(expression, split_terms(expression)) for expression in expressions]
    union = sort_terms({term for _, parts in sums if parts is not None for term in parts})
    if len(subsets) or not union or len(union) > _MOST_UNION:
        more = [term for term in union if term not in terms]
        union = [*terms, *more][:_MOST_UNION]
    index = {term: k for k, term in enumerate(union)}
    supports = [[index[term] for term in parts if term in index] for _, parts in sums if parts is not None]
    groups = [*subsets, *_add_eliminated_supports(weak, union, supports)] or all_index_subsets(1)
    ranked, scorer = score_subsets(weak, terms, union, groups)
    if excess is not None:
        scorer = dataclasses.replace(scorer, excess=excess)
        ranked = score_again(ranked, scorer)
    unique = {frozenset(item.terms): item for item in reversed(ranked)}  # two searches may propose one
    best_first = sorted(unique.values(), key=lambda item: item.criterion)
    candidates = [candidate_from_terms(item) for item in best_first]
    candidates += [left for item, parts in sums if parts is None for left in _prune_expression(item, scorer)]
    return candidates, scorer


def _prune_expression(expression: sympy.Expr, scorer: EquationScorer) -> list[CandidateEquation]:
    """Candidates of an expression that is no sum of terms, and of it with fewer addends."""
    import sympy

    addends = sympy.Add.make_args(sympy.expand(expression))
    candidates = [_score_expression(expression, scorer)]
    if not 1 < len(addends) <= MOST_TERMS:
        return candidates
    columns = scorer.whitening @ np.stack(
        [scorer.weak.expression_integrals(item) for item in addends], axis=1
    )
    if not np.isfinite(columns).all():
        return candidates
    target = scorer.whitening @ scorer.weak.target
    for chosen in eliminate_backward(columns, target, range(len(addends))):
        factors = np.linalg.lstsq(columns[:, chosen], target, rcond=1e-12)[0]
        parts = (sympy.Float(factor) * addends[k] for k, factor in zip(chosen, factors, strict=True))
        candidates.append(_score_expression(sympy.Add(*parts), scorer))
    return candidates


def _find_motion_expressions(study: Study, search: SymbolicSearch) -> list[sympy.Expr]:
    import sympy

    _, v, _ = state_symbols()
    motions = study.weak.motions
    own = [term for term in study.terms if isinstance(term, CustomTerm)]
    parts = [_search_samples(motion, study.left_side, len(motions), own) for motion in motions]
    samples = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    target = samples.pop("target")
    noise = math.sqrt(sum(motion.acceleration_noise**2 for motion in motions) / len(motions))
    replaced = {
        sympy.Symbol("speed", real=True): sympy.Abs(v),
        sympy.Symbol("direction", real=True): sympy.sign(v),
    }
    replaced |= {sympy.Symbol(f"own{k}", real=True): item.expression for k, item in enumerate(own)}
    return [expression.xreplace(replaced) for expression in search.find_expressions(samples, target, noise)]


def _search_samples(
    motion: SmoothedMotion, left_side: str, motions: int, own: Sequence[CustomTerm]
) -> dict[str, np.ndarray]:
    """Return the samples of one of so many motions for a symbolic regression, away from its ends."""
    motion = motion.inner
    every = max(1, math.ceil(len(motion.time) * motions / _MOST_POINTS))
    samples = {"target": motion.acceleration}
    if left_side == "height":
        samples[TIME] = motion.time
    else:
        samples |= {
            "z": motion.smooth,
            "v": motion.velocity,
            "speed": np.abs(motion.velocity),
            "direction": np.sign(motion.velocity),
        }
        if motion.drive is not None:
            samples["u"] = motion.drive
        samples |= {f"own{k}": item.values(motion.smooth_state) for k, item in enumerate(own)}
    return {name: values[::every] for name, values in samples.items()}


def candidate_from_terms(scored_terms: ScoredTerms) -> CandidateEquation:
    """Candidate equation of a scored subset of terms."""
    expression = linear_combination(scored_terms.terms, list(scored_terms.coefficients))
    return CandidateEquation(expression, complexity(expression), scored_terms.misfit, scored_terms.criterion)


def _score_expression(expression: sympy.Expr, scorer: EquationScorer) -> CandidateEquation:
    """Candidate that is no sum of terms, by the residuals of its present form."""
    import sympy

    weak = scorer.weak
    left = scorer.whitening @ (weak.target - weak.expression_integrals(expression))
    count = len(expression.atoms(sympy.Float))
    squares = float(left @ left)
    if not math.isfinite(squares):
        squares = math.inf
    return CandidateEquation(
        expression,
        complexity(expression),
        scorer.misfit_from_squares(squares, count),
        scorer.information_criterion(squares, count),
    )
