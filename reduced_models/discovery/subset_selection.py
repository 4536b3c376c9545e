"""Selection of terms: all subsets of a library, weighed by their weak residuals."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm

MOST_TERMS = 8
_RETAINED = 3  # subsets of a size
_ROUNDS = 3  # of the covariance, which depends on the coefficients
_MOST_SUBSETS = 400_000


@dataclasses.dataclass(frozen=True)
class ScoredTerms:
    """A subset of the terms, with what its weak residuals say.

    Attributes
    ----------
    terms : tuple of Term
    coefficients : float64 (k,)
    misfit : float
        Rms of the residuals, in standard deviations of what the record's noise makes of them: 1
        where the equation holds.
    criterion : float
        Extended Bayesian information criterion (Chen & Chen 2008, doi:10.1093/biomet/asn034).
    """

    terms: tuple[AnyTerm, ...]
    coefficients: np.ndarray
    misfit: float
    criterion: float


@dataclasses.dataclass(frozen=True, eq=False)
class EquationScorer:
    """The white weak residuals of the records, which weigh any equation.

    Attributes
    ----------
    weak : WeakForm
    whitening : float64 (q, r)
    excess : float
        Factor by which the squares exceed the noise even with all terms of the library: above 1
        where the library does not hold the law. The criterion counts in it (Burnham & Anderson
        2002, quasi-likelihood).
    library_size : int
        Terms of the library that was searched.
    """

    weak: WeakForm
    whitening: np.ndarray
    excess: float
    library_size: int

    @property
    def residual_count(self) -> int:
        return len(self.whitening)

    def squares_from_misfit(self, misfit: float, count: int) -> float:
        """Return the sum of squares of an equation with so many numbers by its misfit."""
        return misfit**2 * max(1, self.residual_count - count)

    def misfit_from_squares(self, squares: float, count: int) -> float:
        """Return the misfit of an equation with so many numbers by its sum of squares."""
        return math.sqrt(squares / max(1, self.residual_count - count))

    def information_criterion(self, squares: float, count: int) -> float:
        """Return the criterion of an equation with so many free numbers and that sum of squares."""
        choices = math.log(math.comb(max(self.library_size, count), count))
        samples = math.log(self.weak.sample_count)
        return squares / self.excess + count * samples + 2.0 * choices


def scorers_in_common_unit(scorers: Sequence[EquationScorer]) -> list[EquationScorer]:
    """Return scorers that count in one unit of misfit: that of the library which leaves least."""
    excess = min(scorer.excess for scorer in scorers)
    return [dataclasses.replace(scorer, excess=excess) for scorer in scorers]


def all_index_subsets(count: int) -> list[np.ndarray]:
    """Subsets (s, k) of ``count`` terms for each size k, as far as they can all be tried."""
    subsets, total = [], 0
    for size in range(1, min(count, MOST_TERMS) + 1):
        total += math.comb(count, size)
        if total > _MOST_SUBSETS:
            break
        subsets.append(np.array(list(itertools.combinations(range(count), size))))
    return subsets


def group_subsets_by_size(subsets: Iterable[Iterable[int]]) -> list[np.ndarray]:
    """Given subsets, without repetitions, as arrays (s, k) for each size k."""
    groups: dict[int, set[tuple[int, ...]]] = {}
    for subset in subsets:
        chosen = tuple(sorted(set(subset)))
        if chosen:
            groups.setdefault(len(chosen), set()).add(chosen)
    return [np.array(sorted(groups[size])) for size in sorted(groups)]


def score_subsets(
    weak: WeakForm, library: Sequence[AnyTerm], terms: Sequence[AnyTerm], subsets: list[np.ndarray]
) -> tuple[list[ScoredTerms], EquationScorer]:
    """Best few subsets of each size, best criterion first, and the scorer that weighed them.

    Parameters
    ----------
    weak : WeakForm
    library : sequence of Term
        That was searched; it sets the price of a term.
    terms : sequence of Term
        That the subsets number.
    subsets : list of int (s, k)
    """
    best: ScoredTerms | None = None
    matrix, every = weak.term_integral_matrix(terms), weak.term_integral_matrix(library)
    ranked: list[ScoredTerms] = []
    for _ in range(_ROUNDS):
        # The first covariance is that of z'' alone; then that of the best equation so far.
        known = ((), np.zeros(0)) if best is None else (best.terms, best.coefficients)
        scorer = _make_scorer(weak, every, weak.whitening_matrix(*known))
        ranked = _rank_subsets(scorer, matrix, terms, subsets)
        best = ranked[0]
    return ranked, scorer


def normalise_columns(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (n, p) of unit length, and the lengths (p,) that they had."""
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return columns / sizes, sizes


def score_terms(scorer: EquationScorer, terms: Sequence[AnyTerm]) -> ScoredTerms:
    """One subset, by the same residuals as all others."""
    matrix = scorer.weak.term_integral_matrix(terms)
    return _rank_subsets(scorer, matrix, terms, [np.arange(len(terms))[None]])[0]


def _make_scorer(weak: WeakForm, every: np.ndarray, whitening: np.ndarray) -> EquationScorer:
    columns, target = normalise_columns(whitening @ every)[0], whitening @ weak.target
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]
    freedom = max(1, len(target) - columns.shape[1])
    return EquationScorer(weak, whitening, max(1.0, float(left @ left) / freedom), every.shape[1])


def _rank_subsets(
    scorer: EquationScorer, matrix: np.ndarray, terms: Sequence[AnyTerm], subsets: list[np.ndarray]
) -> list[ScoredTerms]:
    columns, sizes = normalise_columns(scorer.whitening @ matrix)
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
            # From the residuals themselves: the difference of two large sums keeps no digits.
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


def eliminate_backward(
    white_columns: np.ndarray, target: np.ndarray, start: Sequence[int]
) -> list[list[int]]:
    """Backward elimination: a subset, and what is left after the least needed term goes, and so on.

    Parameters
    ----------
    white_columns : float64 (q, p)
        White columns.
    target : float64 (q,)
    start : sequence of int
    """
    columns, _ = normalise_columns(white_columns)
    gram, moment = columns.T @ columns, columns.T @ target
    left = list(start)
    path = [list(left)]
    while len(left) > 1:
        # A term's worth is its coefficient squared over its variance.
        inverse = np.linalg.pinv(gram[np.ix_(left, left)], rcond=1e-12, hermitian=True)
        values = inverse @ moment[left]
        worth = values**2 / np.maximum(np.diag(inverse), 1e-300)
        left.pop(int(np.argmin(worth)))
        path.append(list(left))
    return path
