"""What each term of a chosen sum buys, and how surely the structure is the right one.

Stability selection: halves of the integrals are drawn at random, and each chooses anew (Meinshausen
& Buhlmann 2010, doi:10.1111/j.1467-9868.2010.00740.x).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.selection import Judge, weighed
from reduced_models.discovery.terms import AnyTerm, in_order, sum_text

_RESAMPLES = 200
_LEAST_SHARE = 0.1
"""Of the resamples: a structure that wins less often is no rival."""


class Evidence(NamedTuple):
    """How sure a structure is.

    Attributes
    ----------
    prices : dict of str to float
        By how much the information criterion rises where a term is left out.
    share : float
        Of random halves of the integrals, that choose this structure or it with more terms.
    rivals : tuple of str
        Structures that the others choose, the most frequent first.
    """

    prices: dict[str, float]
    share: float
    rivals: tuple[str, ...]

    @property
    def note(self) -> str:
        """That the data cannot tell, where they cannot; empty otherwise."""
        if not self.rivals:
            return ""
        return (
            f"the data cannot tell this structure from {' or '.join(self.rivals)}: of "
            f"{_RESAMPLES} random halves of it {100 * self.share:.0f} % choose it"
        )


def evidence(
    chosen: CandidateEquation, candidates: Sequence[CandidateEquation], judge: Judge, seed: int
) -> Evidence | None:
    """Of a chosen sum of terms beside other candidates; None where it is no such sum."""
    if chosen.terms is None or not chosen.terms:
        return None
    own = in_order(chosen.terms)
    whole = weighed(judge, own).criterion
    prices = {
        term.text: (weighed(judge, rest).criterion if rest else _empty(judge)) - whole
        for term in own
        if (rest := [one for one in own if one != term]) is not None
    }
    structures = [tuple(own)]
    for one in candidates:
        terms = None if one.terms is None else tuple(in_order(one.terms))
        if terms and terms not in structures:
            structures.append(terms)
    shares = _shares(judge, structures, seed)
    order = np.argsort(-shares[1:], kind="stable") + 1
    # With a further term the structure holds as well: that is no other one.
    rivals = tuple(
        sum_text(structures[k])
        for k in order
        if shares[k] >= _LEAST_SHARE and not set(structures[k]) >= set(own)
    )
    share = sum(
        value for value, terms in zip(shares, structures, strict=True) if set(terms) >= set(own)
    )
    return Evidence(prices, float(share), rivals)


def _empty(judge: Judge) -> float:
    target = judge.whitening @ judge.weak.target
    return judge.criterion(float(target @ target), 0)


def _shares(judge: Judge, structures: Sequence[tuple[AnyTerm, ...]], seed: int) -> np.ndarray:
    """Share of the resamples of the white integrals in which each structure is best."""
    union = in_order({term for terms in structures for term in terms})
    place = {term: k for k, term in enumerate(union)}
    columns = judge.whitening @ judge.weak.matrix(union)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    target = judge.whitening @ judge.weak.target
    chosen = [np.array([place[term] for term in terms]) for terms in structures]
    random = np.random.default_rng(seed)
    wins = np.zeros(len(structures))
    for _ in range(_RESAMPLES):
        half = random.permutation(len(target))[: len(target) // 2]
        matrix, vector = columns[half], target[half]
        gram, moment, total = matrix.T @ matrix, matrix.T @ vector, float(vector @ vector)
        criteria = [_criterion(judge, gram, moment, total, one) for one in chosen]
        wins[int(np.argmin(criteria))] += 1.0
    return wins / _RESAMPLES


def _criterion(
    judge: Judge, gram: np.ndarray, moment: np.ndarray, total: float, chosen: np.ndarray
) -> float:
    inner = gram[np.ix_(chosen, chosen)] + 1e-12 * np.eye(len(chosen))
    gain = float(moment[chosen] @ np.linalg.solve(inner, moment[chosen]))
    return judge.criterion(total - gain, len(chosen))
