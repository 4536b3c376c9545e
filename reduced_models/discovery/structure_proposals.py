"""Candidate structures: sparse sums of terms, and expressions of symbolic regressions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from reduced_models.discovery.hidden_states import ScaledHiddenState
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.subset_selection import (
    MOST_TERMS,
    EquationScorer,
    ScoredTerms,
    all_index_subsets,
    eliminate_backward,
    group_subsets_by_size,
    normalise_columns,
    score_subsets,
)
from reduced_models.discovery.terms import (
    AnyTerm,
    CustomTerm,
    complexity,
    linear_combination,
    sort_terms,
    split_terms,
    state_symbols,
    term_columns,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm

if TYPE_CHECKING:
    import sympy
    from jaxtyping import Float

_MOST_POINTS = 500  # of a symbolic regression
_EDGE = 0.02  # of the record at each end, where derivatives are poor
_MOST_UNION = 120
_ENSEMBLES = (0.01, 0.03, 0.1)  # thresholds


class SymbolicSearch(NamedTuple):
    """A symbolic regression by one of the programs for it."""

    method: str
    functions: tuple[str, ...] = ()
    effort: float = 1.0  # times the usual length of the search
    seed: int = 0

    def find_expressions(
        self,
        inputs: Mapping[str, np.ndarray],
        target: Float[np.ndarray, "n"],
        noise: float,
        elliptic: bool = False,
    ) -> list[sympy.Expr]:
        """Find expressions for a target by symbolic regression."""
        if self.method == "pysr":
            from reduced_models.discovery.pysr_search import search_expressions_with_pysr

            return search_expressions_with_pysr(
                inputs, target, noise, self.functions, elliptic, self.effort, self.seed
            )
        from reduced_models.discovery.operon_search import search_expressions_with_operon

        return search_expressions_with_operon(inputs, target, noise, self.functions, self.effort, self.seed)


class ProposedStructures(NamedTuple):
    """Candidate equations, and what scores them."""

    candidates: list[CandidateEquation]
    scorer: EquationScorer
    inclusion_fractions: Mapping[str, float] = MappingProxyType({})  # of an ensemble's members, by term
    others: Sequence[CandidateEquation] = ()  # with other hidden states, only shown
    notes: tuple[str, ...] = ()
    hidden_state: ScaledHiddenState | None = None


def propose_structures(
    weak: WeakForm,
    terms: Sequence[AnyTerm],
    search: SymbolicSearch | None,
    *,
    sparse: bool = True,
    form: str = "weak",
    ensemble: bool = False,
    seed: int = 0,
) -> ProposedStructures:
    """Propose sums of terms and expressions of symbolic regression, all scored alike."""
    supports, inclusion_fractions = list[np.ndarray](), dict[str, float]()
    if sparse:
        supports, inclusion_fractions = _sparse_supports(weak, terms, form, ensemble, seed)
    if search is None:
        ranked, scorer = score_subsets(weak, terms, terms, supports)
        return ProposedStructures(
            [candidate_from_terms(candidate) for candidate in ranked], scorer, inclusion_fractions
        )
    return ProposedStructures(
        *propose_symbolic_candidates(weak, terms, search, supports), inclusion_fractions
    )


def _sparse_supports(
    weak: WeakForm, terms: Sequence[AnyTerm], form: str, ensemble: bool, seed: int
) -> tuple[list[np.ndarray], dict[str, float]]:
    if form == "weak" and not ensemble:
        return all_index_subsets(len(terms)), {}

    regression = (
        weak_form_regression(weak, terms) if form == "weak" else strong_form_regression(weak.motions, terms)
    )
    supports = regression.supports_by_threshold()
    inclusion_fractions: dict[str, float] = {}
    if ensemble:
        ensembles = [ensemble_supports(regression, threshold, seed) for threshold in _ENSEMBLES]
        supports = [support for item, _ in ensembles for support in item]
        fractions = ensembles[len(ensembles) // 2][1]
        inclusion_fractions = {
            term.text: float(fraction) for term, fraction in zip(terms, fractions, strict=True)
        }
    return _add_eliminated_supports(weak, terms, supports), inclusion_fractions


def _add_eliminated_supports(
    weak: WeakForm, terms: Sequence[AnyTerm], supports: Sequence[Sequence[int]]
) -> list[np.ndarray]:
    """Supports, and all that backward elimination makes of them."""
    whitening = weak.whitening_matrix((), np.zeros(0))
    matrix, target = whitening @ weak.term_integral_matrix(terms), whitening @ weak.target
    paths = (path for support in supports if support for path in eliminate_backward(matrix, target, support))
    return group_subsets_by_size(paths)


def propose_symbolic_candidates(
    weak: WeakForm, terms: Sequence[AnyTerm], search: SymbolicSearch, subsets: Sequence[np.ndarray] = ()
) -> tuple[list[CandidateEquation], EquationScorer]:
    """Propose expressions of a symbolic regression, and what each is without some of its terms."""
    expressions = _find_motion_expressions(weak.motions, terms, search)
    sums = [(expression, split_terms(expression)) for expression in expressions]
    union = sort_terms({term for _, parts in sums if parts is not None for term in parts})
    if len(subsets) or not union or len(union) > _MOST_UNION:
        more = [term for term in union if term not in terms]
        union = [*terms, *more][:_MOST_UNION]
    index = {term: k for k, term in enumerate(union)}
    supports = [[index[term] for term in parts if term in index] for _, parts in sums if parts is not None]
    groups = [*subsets, *_add_eliminated_supports(weak, union, supports)] or all_index_subsets(1)
    ranked, scorer = score_subsets(weak, terms, union, groups)
    candidates = [candidate_from_terms(item) for item in _unique_subsets(ranked)]
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


def _unique_subsets(ranked: Sequence[ScoredTerms]) -> list[ScoredTerms]:
    """Each subset once, though two searches propose it."""
    unique = {frozenset(candidate.terms): candidate for candidate in reversed(ranked)}
    return sorted(unique.values(), key=lambda item: item.criterion)


def _find_motion_expressions(
    motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm], search: SymbolicSearch
) -> list[sympy.Expr]:
    import sympy

    _, v, _ = state_symbols()
    own = [term for term in terms if isinstance(term, CustomTerm)]
    parts = [_search_samples(motion, len(motions), own) for motion in motions]
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
    motion: SmoothedMotion, motions: int, own: Sequence[CustomTerm] = ()
) -> dict[str, np.ndarray]:
    """Return the samples of one of so many motions for a symbolic regression, away from its ends."""
    edge = int(_EDGE * len(motion.time))
    inner = len(motion.time) - 2 * edge
    rows = slice(edge, edge + inner, max(1, math.ceil(inner * motions / _MOST_POINTS)))
    samples = {
        "z": motion.smooth,
        "v": motion.velocity,
        "speed": np.abs(motion.velocity),
        "direction": np.sign(motion.velocity),
        "target": motion.acceleration,
    }
    if motion.drive is not None:
        samples["u"] = motion.drive
    for k, item in enumerate(own):
        samples[f"own{k}"] = item.values(motion.smooth, motion.velocity, motion.drive)
    return {name: values[rows] for name, values in samples.items()}


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


_THRESHOLDS = np.geomspace(1e-3, 0.5, 24)
"""Thresholds of coefficients of columns of unit size, as fractions of the target's size."""
_MODELS = 100  # a fraction of them is known to 0.05
_INCLUDED = (0.9, 0.75, 0.5, 0.25)
_MOST_ROWS = 4000


class SparseRegression:
    """A linear regression for PySINDy's optimizers, with columns and target of unit size."""

    # SINDy says which terms z'' calls for (Brunton, Proctor & Kutz 2016, doi:10.1073/pnas.1517384113), an
    # ensemble how often resamples agree (Fasel, Kutz, Brunton & Brunton 2022, doi:10.1098/rspa.2021.0904).

    def __init__(self, matrix: np.ndarray, target: np.ndarray) -> None:
        self.matrix = normalise_columns(matrix)[0] * np.sqrt(len(matrix))
        self.target = target / max(float(np.sqrt((target**2).mean())), 1e-300)

    def thresholded_optimizer(self, threshold: float) -> Any:
        """PySINDy's sequentially thresholded least squares (Brunton, Proctor & Kutz 2016)."""
        import pysindy

        return pysindy.STLSQ(threshold=float(threshold), alpha=1e-8)

    def supports_by_threshold(self) -> list[list[int]]:
        """Terms that thresholded least squares keep, at 24 thresholds from 0.001 to 0.5."""
        supports = []
        for threshold in _THRESHOLDS:
            with warnings.catch_warnings(action="ignore"):  # that a high threshold leaves nothing
                fitted = self.thresholded_optimizer(threshold).fit(self.matrix, self.target[:, None])
            supports.append(np.flatnonzero(fitted.coef_[0]).tolist())
        return supports

    def inclusion_fractions(self, threshold: float, seed: int) -> Float[np.ndarray, "p"]:
        """Fraction of a hundred bootstrap resamples whose sparse fit keeps each term."""
        import pysindy

        ensemble = pysindy.EnsembleOptimizer(
            self.thresholded_optimizer(threshold), bagging=True, n_models=_MODELS
        )
        state = np.random.get_state()  # noqa: NPY002  PySINDy draws from NumPy's global generator
        np.random.seed(seed)  # noqa: NPY002
        try:
            with warnings.catch_warnings(action="ignore"):
                ensemble.fit(self.matrix, self.target[:, None])
        finally:
            np.random.set_state(state)  # noqa: NPY002
        return np.asarray(np.mean(np.stack(ensemble.coef_list)[:, 0] != 0.0, axis=0))


def strong_form_regression(motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm]) -> SparseRegression:
    """Regression of estimates of z'' on terms, sample by sample, away from the records' ends."""
    rows = [_interior_samples(motion, terms, len(motions)) for motion in motions]
    matrices, targets = zip(*rows, strict=True)
    return SparseRegression(np.concatenate(matrices), np.concatenate(targets))


def _interior_samples(
    motion: SmoothedMotion, terms: Sequence[AnyTerm], motions: int
) -> tuple[np.ndarray, np.ndarray]:
    count = len(motion.time)
    edge = int(_EDGE * count)
    rows = slice(edge, count - edge, max(1, count * motions // _MOST_ROWS))
    matrix = term_columns(terms, motion.smooth, motion.velocity, motion.drive)
    return matrix[rows], motion.acceleration[rows]


def weak_form_regression(weak: WeakForm, terms: Sequence[AnyTerm]) -> SparseRegression:
    """Regression of the weak form, whitened for the noise of z'' alone."""
    # Weak-form SINDy (Messenger & Bortz 2021, doi:10.1137/20M1343166).
    whitening = weak.whitening_matrix((), np.zeros(0))
    return SparseRegression(whitening @ weak.term_integral_matrix(terms), whitening @ weak.target)


def ensemble_supports(
    regression: SparseRegression, threshold: float, seed: int
) -> tuple[list[list[int]], np.ndarray]:
    """Terms that many resamples keep, and the fraction that keeps each."""
    fractions = regression.inclusion_fractions(threshold, seed)
    return [np.flatnonzero(fractions >= least).tolist() for least in _INCLUDED], fractions
