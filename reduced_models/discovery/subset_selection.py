"""Selection of terms: all subsets of a library, weighed by their weak residuals."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from granular.shared.array_types import Float
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm

MOST_TERMS = 8
_RETAINED = 3  # subsets of a size
_ROUNDS = 3  # of the covariance, which depends on the coefficients
# Their normal matrices of eight terms take 200 MB.
_MOST_SUBSETS = 400_000


@dataclasses.dataclass(frozen=True)
class ScoredTerms:
    """A subset of the terms, with what its weak residuals say."""

    terms: tuple[AnyTerm, ...]
    coefficients: Float[np.ndarray, "k"]
    misfit: float  # rms residual over what the record's noise makes of it
    criterion: float  # extended Bayesian (Chen & Chen 2008)


@dataclasses.dataclass(frozen=True, eq=False)
class EquationScorer:
    """The white weak residuals of the records, which weigh any equation."""

    weak: WeakForm
    whitening: Float[np.ndarray, "q r"]
    excess: float  # squares over the noise with all terms: above 1 if the law is not in it
    library_size: int

    def misfit_from_squares(self, squares: float, count: int) -> float:
        """Misfit of an equation, from the sum of squares of its whitened residuals."""
        return math.sqrt(squares / max(1, len(self.whitening) - count))

    def information_criterion(self, squares: float, count: int) -> float:
        """Compute the extended Bayesian information criterion of an equation."""
        # squares/excess + k ln n + 2 ln C(p, k) for k numbers, n samples, p terms to choose from (Chen & Chen
        # 2008, doi:10.1093/biomet/asn034), the excess as of a quasi-likelihood (Burnham & Anderson 2002).
        choices = math.log(math.comb(max(self.library_size, count), count))
        samples = math.log(self.weak.sample_count)
        return squares / self.excess + count * samples + 2.0 * choices


def scorers_in_common_unit(scorers: Sequence[EquationScorer]) -> list[EquationScorer]:
    """Scorers with one excess, the least of theirs, so that their criteria can be compared."""
    excess = min(scorer.excess for scorer in scorers)
    return [dataclasses.replace(scorer, excess=excess) for scorer in scorers]


def score_again(ranked: Iterable[ScoredTerms], scorer: EquationScorer) -> list[ScoredTerms]:
    """Scored subsets by the criterion of a scorer in another unit, the best one first."""
    again = []
    for item in ranked:
        count = len(item.terms)
        squares = item.misfit**2 * max(1, len(scorer.whitening) - count)
        again.append(dataclasses.replace(item, criterion=scorer.information_criterion(squares, count)))
    return sorted(again, key=lambda item: item.criterion)


def all_index_subsets(count: int) -> list[np.ndarray]:
    """All subsets of so many terms, by their indices, as far as they can all be tried."""
    subsets, total = [], 0
    for size in range(1, min(count, MOST_TERMS) + 1):
        total += math.comb(count, size)
        if total > _MOST_SUBSETS:
            break
        subsets.append(np.array(list(itertools.combinations(range(count), size))))
    return subsets


def group_subsets_by_size(subsets: Iterable[Iterable[int]]) -> list[np.ndarray]:
    """Given subsets, each once, in an array (s, k) for each size k."""
    groups: dict[int, set[tuple[int, ...]]] = {}
    for subset in subsets:
        chosen = tuple(sorted(set(subset)))
        if chosen:
            groups.setdefault(len(chosen), set()).add(chosen)
    return [np.array(sorted(groups[size])) for size in sorted(groups)]


def score_subsets(
    weak: WeakForm, library: Sequence[AnyTerm], terms: Sequence[AnyTerm], subsets: list[np.ndarray]
) -> tuple[list[ScoredTerms], EquationScorer]:
    """Score subsets of terms, an array (s, k) of indices for each size, by their whitened weak residuals."""
    # The covariance of the residuals depends on the coefficients, so it is taken from the best equation so
    # far, twice (Bortz, Messenger & Dukic 2023, doi:10.1007/s11538-023-01208-6).
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


def normalise_columns(columns: Float[np.ndarray, "n p"]) -> tuple[np.ndarray, np.ndarray]:
    """Divide columns by their Euclidean lengths."""
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return columns / sizes, sizes


def score_terms(scorer: EquationScorer, terms: Sequence[AnyTerm]) -> ScoredTerms:
    """Score one subset of terms by the whitened residuals of a scorer."""
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
    white_columns: Float[np.ndarray, "q p"], target: Float[np.ndarray, "q"], start: Sequence[int]
) -> list[list[int]]:
    """Eliminate terms backward: from a subset the least needed term goes, and so on."""
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
