"""Which structures are tried: sparse sums of terms, or what a symbolic regression proposes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.discovery.own_terms import OwnTerm
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.selection import (
    Judge,
    Scored,
    all_subsets,
    by_size,
    pruned,
    scored,
)
from reduced_models.discovery.symbols import symbols
from reduced_models.discovery.terms import AnyTerm, complexity, in_order, sum_of, terms_of
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm

if TYPE_CHECKING:
    import sympy

_MOST_POINTS = 500  # of a symbolic regression
_EDGE = 0.02
_MOST_UNION = 120
_ENSEMBLES = (0.01, 0.03, 0.1)  # thresholds


class Search(NamedTuple):
    """How a symbolic regression searches.

    Attributes
    ----------
    method : str
        ``"operon"`` or ``"pysr"``.
    functions : tuple of str
        By the names that its program knows.
    effort : float
        Times the usual length of the search.
    seed : int
    """

    method: str
    functions: tuple[str, ...] = ()
    effort: float = 1.0
    seed: int = 0


def sindy_supports(
    weak: WeakForm, terms: Sequence[AnyTerm], form: str, ensemble: bool, seed: int
) -> tuple[list[np.ndarray], dict[str, float]]:
    if form == "weak" and not ensemble:
        return all_subsets(len(terms)), {}
    from reduced_models.discovery.sparse import (
        ensemble_supports,
        strong_regression,
        weak_regression,
    )

    if form == "weak":
        regression = weak_regression(weak, terms)
    else:
        regression = strong_regression(weak.motions, terms)
    supports = regression.supports()
    inclusion: dict[str, float] = {}
    if ensemble:
        found = [ensemble_supports(regression, threshold, seed) for threshold in _ENSEMBLES]
        supports = [support for one, _ in found for support in one]
        shares = found[len(found) // 2][1]
        inclusion = {term.text: float(share) for term, share in zip(terms, shares, strict=True)}
    return _eliminated(weak, terms, supports), inclusion


def _eliminated(
    weak: WeakForm, terms: Sequence[AnyTerm], supports: Sequence[Sequence[int]]
) -> list[np.ndarray]:
    """Supports, and all that backward elimination makes of them."""
    whitening = weak.whitening((), np.zeros(0))
    matrix, target = whitening @ weak.matrix(terms), whitening @ weak.target
    paths = (path for support in supports if support for path in pruned(matrix, target, support))
    return by_size(paths)


def symbolic_candidates(
    weak: WeakForm,
    terms: Sequence[AnyTerm],
    search: Search,
    subsets: Sequence[np.ndarray] = (),
) -> tuple[list[CandidateEquation], Judge]:
    """Expressions of a symbolic regression; of sums of terms also what can be left out of them.

    ``subsets`` of the terms stand beside them, judged alike.
    """
    expressions = _expressions(weak.motions, terms, search)
    sums = [(one, terms_of(one)) for one in expressions]
    union = in_order({term for _, found in sums if found is not None for term in found})
    if len(subsets) or not union or len(union) > _MOST_UNION:
        more = [term for term in union if term not in terms]
        union = [*terms, *more][:_MOST_UNION]
    place = {term: k for k, term in enumerate(union)}
    supports = [
        [place[term] for term in found if term in place] for _, found in sums if found is not None
    ]
    groups = [*subsets, *_eliminated(weak, union, supports)] or all_subsets(1)
    ranked, judge = scored(weak, terms, union, groups)
    candidates = [candidate_of(one) for one in _once(ranked)]
    candidates += [_judged(one, judge) for one, found in sums if found is None]
    return candidates, judge


def _once(ranked: Sequence[Scored]) -> list[Scored]:
    """Each subset once, though two searches propose it."""
    found = {frozenset(one.terms): one for one in reversed(ranked)}
    return sorted(found.values(), key=lambda one: one.criterion)


def _expressions(
    motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm], search: Search
) -> list[sympy.Expr]:
    import sympy

    _, v, _ = symbols()
    own = [term for term in terms if isinstance(term, OwnTerm)]
    parts = [_search_samples(motion, len(motions), own) for motion in motions]
    samples = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    target = samples.pop("target")
    noise = math.sqrt(sum(motion.acceleration_noise**2 for motion in motions) / len(motions))
    if search.method == "pysr":
        from reduced_models.discovery.julia import pysr_expressions

        found = pysr_expressions(
            samples, target, noise, search.functions, effort=search.effort, seed=search.seed
        )
    else:
        from reduced_models.discovery.symbolic import operon_expressions

        found = operon_expressions(
            samples, target, noise, search.functions, search.effort, search.seed
        )
    replaced = {
        sympy.Symbol("speed", real=True): sympy.Abs(v),
        sympy.Symbol("direction", real=True): sympy.sign(v),
    }
    replaced |= {sympy.Symbol(f"own{k}", real=True): one.expression for k, one in enumerate(own)}
    return [one.xreplace(replaced) for one in found]


def _search_samples(
    motion: SmoothedMotion, motions: int, own: Sequence[OwnTerm] = ()
) -> dict[str, np.ndarray]:
    """What a symbolic regression sees of one of so many motions, away from its ends.

    Own terms are variables beside z and z'.
    """
    edge = int(_EDGE * len(motion.time))
    inner = len(motion.time) - 2 * edge
    rows = slice(edge, edge + inner, max(1, math.ceil(inner * motions / _MOST_POINTS)))
    found = {
        "z": motion.smooth,
        "v": motion.velocity,
        "speed": np.abs(motion.velocity),
        "direction": np.sign(motion.velocity),
        "target": motion.acceleration,
    }
    if motion.drive is not None:
        found["u"] = motion.drive
    for k, one in enumerate(own):
        found[f"own{k}"] = one.values(motion.smooth, motion.velocity, motion.drive)
    return {name: values[rows] for name, values in found.items()}


def candidate_of(one: Scored) -> CandidateEquation:
    expression = sum_of(one.terms, list(one.coefficients))
    return CandidateEquation(expression, complexity(expression), one.misfit, one.criterion)


def _judged(expression: sympy.Expr, judge: Judge) -> CandidateEquation:
    """A candidate that is no sum of terms, by its residuals as it stands."""
    import sympy

    weak = judge.weak
    left = judge.whitening @ (weak.target - weak.integral(expression))
    count = len(expression.atoms(sympy.Float))
    squares = float(left @ left)
    if not math.isfinite(squares):
        squares = math.inf
    misfit = math.sqrt(squares / max(1, judge.rows - count))
    return CandidateEquation(
        expression, complexity(expression), misfit, judge.criterion(squares, count)
    )
