"""Selection of terms: all subsets of a library, scored by their weak-form residuals."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from granular.shared.array_types import Float
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm

MAXIMUM_TERMS = 8
_RETAINED = 3  # number of subsets of each size that are kept
_ROUNDS = 3  # updates of the covariance, which depends on the coefficients
# The normal matrices of this number of subsets of eight terms take 200 MB.
_MAXIMUM_SUBSETS = 400_000


@dataclasses.dataclass(frozen=True)
class ScoredTerms:
    """A subset of the terms with its coefficients and scores."""

    terms: tuple[AnyTerm, ...]
    coefficients: Float[np.ndarray, "k"]
    misfit: float  # rms residual relative to the residual that the record's noise causes
    criterion: float  # extended Bayesian information criterion (Chen & Chen 2008)


@dataclasses.dataclass(frozen=True, eq=False)
class EquationScorer:
    """Scorer of equations by the whitened weak-form residuals of the records."""

    weak: WeakForm
    whitening: Float[np.ndarray, "q r"]
    excess: float  # mean squared residual of all terms over the noise: above 1 if the library lacks the law
    library_size: int

    def misfit_from_squares(self, squares: float, count: int) -> float:
        """Return the rms of the whitened residuals of an equation, given their sum of squares."""
        return math.sqrt(squares / max(1, len(self.whitening) - count))

    def information_criterion(self, squares: float, count: int) -> float:
        """Compute the extended BIC of an equation with ``count`` numbers from its sum of squares."""
        # squares/excess + k ln n + 2 ln C(p, k) for k parameters, n samples, p terms to choose from (Chen &
        # Chen 2008, doi:10.1093/biomet/asn034); excess as in a quasi-likelihood (Burnham & Anderson 2002).
        choices = math.log(math.comb(max(self.library_size, count), count))
        samples = math.log(self.weak.sample_count)
        statistical = count * samples + 2.0 * choices
        return (
            squares + max(self.excess * statistical, count * self.weak.least_effect_sum_of_squares)
        ) / self.excess


def scorers_in_common_unit(scorers: Sequence[EquationScorer]) -> list[EquationScorer]:
    """Set ``excess`` of all scorers to the smallest value, so that their criteria are comparable."""
    excess = min(scorer.excess for scorer in scorers)
    return [dataclasses.replace(scorer, excess=excess) for scorer in scorers]


def rescore_subsets(ranked: Iterable[ScoredTerms], scorer: EquationScorer) -> list[ScoredTerms]:
    """Score subsets again with another scorer, the best first."""
    again = []
    for item in ranked:
        count = len(item.terms)
        squares = item.misfit**2 * max(1, len(scorer.whitening) - count)
        again.append(dataclasses.replace(item, criterion=scorer.information_criterion(squares, count)))
    return sorted(again, key=lambda item: item.criterion)


def all_index_subsets(count: int) -> list[np.ndarray]:
    """Return index arrays of all subsets of ``count`` terms, up to the largest size that can be tried."""
    subsets, total = [], 0
    for size in range(1, min(count, MAXIMUM_TERMS) + 1):
        total += math.comb(count, size)
        if total > _MAXIMUM_SUBSETS:
            break
        subsets.append(np.array(list(itertools.combinations(range(count), size))))
    return subsets


def group_subsets_by_size(subsets: Iterable[Iterable[int]]) -> list[np.ndarray]:
    """Group the distinct subsets into one array (s, k) for each size k."""
    groups: dict[int, set[tuple[int, ...]]] = {}
    for subset in subsets:
        chosen = tuple(sorted(set(subset)))
        if chosen:
            groups.setdefault(len(chosen), set()).add(chosen)
    return [np.array(sorted(groups[size])) for size in sorted(groups)]


def score_subsets_and_make_scorer(
    weak: WeakForm, library: Sequence[AnyTerm], terms: Sequence[AnyTerm], subsets: list[np.ndarray]
) -> tuple[list[ScoredTerms], EquationScorer]:
    """Score subsets, given as an index array (s, k) for each size; return them and the scorer."""
    # The covariance of the residuals depends on the coefficients, so it is recomputed twice from the best
    # equation so far (Bortz, Messenger & Dukic 2023, doi:10.1007/s11538-023-01208-6).
    best: ScoredTerms | None = None
    matrix, every = weak.term_integral_matrix(terms), weak.term_integral_matrix(library)
    ranked: list[ScoredTerms] = []
    for _ in range(_ROUNDS):
        # The first covariance is for z'' alone, the later ones for the best equation so far.
        known = ((), np.zeros(0)) if best is None else (best.terms, best.coefficients)
        scorer = _make_equation_scorer(weak, every, weak.whitening_matrix(*known))
        ranked = _rank_subsets(scorer, matrix, terms, subsets)
        best = ranked[0]
    return ranked, scorer


def normalised_columns_and_lengths(columns: Float[np.ndarray, "n p"]) -> tuple[np.ndarray, np.ndarray]:
    """Return columns divided by their Euclidean lengths, and the lengths."""
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return columns / sizes, sizes


def score_terms(scorer: EquationScorer, terms: Sequence[AnyTerm]) -> ScoredTerms:
    """Score one subset of terms by the whitened residuals of a scorer."""
    matrix = scorer.weak.term_integral_matrix(terms)
    return _rank_subsets(scorer, matrix, terms, [np.arange(len(terms))[None]])[0]


def _make_equation_scorer(weak: WeakForm, every: np.ndarray, whitening: np.ndarray) -> EquationScorer:
    columns, target = normalised_columns_and_lengths(whitening @ every)[0], whitening @ weak.target
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]
    freedom = max(1, len(target) - columns.shape[1])
    return EquationScorer(weak, whitening, max(1.0, float(left @ left) / freedom), every.shape[1])


def _rank_subsets(
    scorer: EquationScorer, matrix: np.ndarray, terms: Sequence[AnyTerm], subsets: list[np.ndarray]
) -> list[ScoredTerms]:
    columns, sizes = normalised_columns_and_lengths(scorer.whitening @ matrix)
    target = scorer.whitening @ scorer.weak.target
    gram, moment = columns.T @ columns, columns.T @ target
    scores = []
    for group in subsets:
        count = group.shape[1]
        grams = gram[group[:, :, None], group[:, None, :]] + 1e-12 * np.eye(count)
        moments = moment[group]
        solved = np.linalg.solve(grams, moments[:, :, None])[:, :, 0]
        gains = (solved * moments).sum(axis=1)
        for k in np.argsort(-gains, kind="stable")[:_RETAINED]:
            chosen = group[k]
            # Computed from the residuals: the difference of two large sums would lose all digits.
            left = target - columns[:, chosen] @ solved[k]
            squares = float(left @ left)
            scores.append(
                ScoredTerms(
                    tuple(terms[index] for index in chosen),
                    solved[k] / sizes[chosen],
                    scorer.misfit_from_squares(squares, count),
                    scorer.information_criterion(squares, count),
                )
            )
    return sorted(scores, key=lambda score: score.criterion)


def backward_elimination_steps(
    white_columns: Float[np.ndarray, "q p"], target: Float[np.ndarray, "q"], start: Sequence[int]
) -> list[list[int]]:
    """Drop the weakest term of a subset until one remains (backward elimination); return each step."""
    columns, _ = normalised_columns_and_lengths(white_columns)
    gram, moment = columns.T @ columns, columns.T @ target
    remaining = list(start)
    path = [list(remaining)]
    while len(remaining) > 1:
        # The weakest term has the smallest squared coefficient over its variance.
        inverse = np.linalg.pinv(gram[np.ix_(remaining, remaining)], rcond=1e-12, hermitian=True)
        values = inverse @ moment[remaining]
        significance = values**2 / np.maximum(np.diag(inverse), 1e-300)
        remaining.pop(int(np.argmin(significance)))
        path.append(list(remaining))
    return path
