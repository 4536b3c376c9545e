"""`discover`: the equation of a record, by sparse or by symbolic regression."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.discovery.polishing import parametrised, polished
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.selection import (
    Judge,
    Scored,
    all_subsets,
    by_size,
    pruned,
    scored,
    weighed,
)
from reduced_models.discovery.terms import (
    Term,
    complexity,
    library,
    sum_of,
    symbols,
    terms_of,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm, weak_form
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod, derivatives
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.inputs import column

if TYPE_CHECKING:
    import sympy

Method = Literal["sindy", "operon", "pysr"]
METHODS: tuple[Method, ...] = ("sindy", "operon", "pysr")

_FLOOR = 1e-6  # least noise, in standard deviations of the record: rounding and quadrature
_MOST_POINTS = 500  # of a symbolic regression
_EDGE = 0.02
_MOST_UNION = 120
_ENSEMBLES = (0.01, 0.03, 0.1)  # thresholds
_POOR = 2.0
_STRONG = 6.0
"""Difference of criteria from which evidence is strong (Kass & Raftery 1995,
doi:10.1080/01621459.1995.10476572); below it the simpler equation is chosen."""
_HOPELESS = 15.0  # a criterion that is so much worse is not made good by fitting


def discover(
    record: PistonRecord | Sequence[PistonRecord],
    method: Method = "sindy",
    *,
    form: Literal["weak", "strong"] = "weak",
    ensemble: bool = False,
    derivative: DerivativeMethod = "savitzky-golay",
    degree: int = 3,
    input: str | None = None,  # noqa: A002
    target: Literal["acceleration", "height"] = "acceleration",
    map: HeightMap | Literal["auto"] = "auto",  # noqa: A002
    polish: int = 3,
    seed: int = 0,
) -> Discovery:
    """Discover the equation of motion z'' = f(z, z', input) of a record, or of several at once.

    Every method proposes structures. All are weighed by the same white residuals of the weak form;
    those that no simpler one beats make the Pareto front; the best of them are fitted through their
    differential equation, and the simplest is chosen to which the information criterion does not
    strongly prefer another.

    Parameters
    ----------
    record : PistonRecord, or a sequence of them
        Several obey the same equation, with the same numbers, each from its own initial state.
    method : str
        ``"sindy"``: a sparse sum of the terms of a physical library, powers of z times 1, z',
        |z'| z' and sign(z'). ``"operon"``: symbolic regression in z, z', |z'| and sign(z') by
        pyoperon. ``"pysr"``: the same by PySR, which needs Julia.
    form : "weak" or "strong"
        For ``"sindy"``: all subsets of the library, on integrals that need no derivative of the
        record (but for drag and friction); or thresholded least squares on an estimate of z''.
    ensemble : bool
        For ``"sindy"``: thresholded least squares on resampled rows; the result says how often each
        term was needed.
    derivative : str
        Estimator of z' and z'', see `derivatives`.
    degree : int
        Of the powers of z in the library, from 1 to 5.
    input : str, optional
        Column of the records that drives the motion ("force", or an extra one).
    target : "acceleration" or "height"
        z'' or, for symbolic regression of one record, z(t) itself. The latter is not polished.
    map : HeightMap or "auto"
        z = (height - shift)/scale. Automatically the height itself, or, where the level of rest is
        farther from zero than the swing is wide, the swing about rest in amplitudes; of the record
        that swings the furthest.
    polish : int
        Greatest number of candidates, best first, that are fitted through their differential
        equation; those whose criterion is hopeless beside the best one's are not.
    seed : int
        Of random searches.

    Returns
    -------
    Discovery

    Raises
    ------
    RecordError
        If the record is too short or does not move, or has no such column.
    InputError
        If an option is out of its range, or a program that the method needs is not installed.
    """
    _check(method, form, target, degree, polish, ensemble)
    records = [record] if isinstance(record, PistonRecord) else list(record)
    if not records:
        raise InputError("there is no record to discover a law in; give at least one")
    if target == "height" and len(records) > 1:
        raise InputError(f"target = 'height' is of one record, not of {len(records)}; give one")
    if method == "pysr":
        from reduced_models.discovery.julia import require_julia

        require_julia()
    height_map = _map(records, map)
    if target == "height":
        from reduced_models.discovery.height import height_equations

        return height_equations(records[0], method, height_map, seed)
    weak = weak_form(*(motion_of(each, height_map, derivative, input) for each in records))
    terms = library(degree, input is not None)
    inclusion: dict[str, float] = {}
    if method == "sindy":
        supports, inclusion = _sindy_supports(weak, terms, form, ensemble, seed)
        ranked, judge = scored(weak, terms, terms, supports)
        candidates = [_candidate(one) for one in ranked]
    else:
        candidates, judge = _symbolic_candidates(weak, terms, method, seed)
    name = f"discovered by {_words(method, form, ensemble)}"
    front, chosen = _polished(
        candidates,
        lambda one: polished(one, records, height_map, input, seed, name),
        polish,
        judge,
    )
    return Discovery(
        _words(method, form, ensemble),
        tuple(front),
        chosen,
        height_map,
        inclusion,
        _notes(front[chosen], judge),
    )


def motion_of(
    record: PistonRecord,
    height_map: HeightMap,
    derivative: DerivativeMethod,
    drive: str | None = None,
) -> SmoothedMotion:
    """The motion of a record in z, with estimates of its derivatives and noise."""
    guess = first_guesses(record)
    smooth = derivatives(record, derivative)
    size = abs(height_map.scale)
    swing = float(record.height.std())
    return SmoothedMotion(
        time=record.time - record.time[0],
        z=np.asarray(height_map.to_law(record.height)),
        smooth=np.asarray(height_map.to_law(smooth.height)),
        velocity=smooth.velocity / height_map.scale,
        acceleration=smooth.acceleration / height_map.scale,
        drive=None if drive is None else column(record, drive),
        noise=max(smooth.record_noise, _FLOOR * swing) / size,
        acceleration_noise=max(smooth.noise.acceleration, _FLOOR * swing) / size,
        period=guess.period,
    )


def _check(method: str, form: str, target: str, degree: int, polish: int, ensemble: bool) -> None:
    for name, value, valid in (
        ("method", method, METHODS),
        ("form", form, ("weak", "strong")),
        ("target", target, ("acceleration", "height")),
    ):
        if value not in valid:
            raise InputError(f"{name} = {quoted(value)}; give one of {', '.join(valid)}")
    if not isinstance(degree, int) or not 1 <= degree <= 5:
        raise InputError(f"degree = {quoted(degree)}; give a whole number from 1 to 5")
    if not isinstance(polish, int) or polish < 0:
        raise InputError(f"polish = {quoted(polish)}; give a whole number from 0 on")
    if method == "sindy" and target == "height":
        raise InputError(
            "target = 'height' needs a symbolic method: give method 'operon' or 'pysr'"
        )
    if method != "sindy" and (ensemble or form != "weak"):
        raise InputError(
            f"form and ensemble belong to method 'sindy'; leave them out of {quoted(method)}"
        )


def _map(records: Sequence[PistonRecord], wanted: HeightMap | str) -> HeightMap:
    if isinstance(wanted, HeightMap):
        return wanted
    if wanted != "auto":
        raise InputError(f"map = {quoted(wanted)}; give 'auto' or a HeightMap")
    guess = max((first_guesses(each) for each in records), key=lambda one: one.amplitude)
    # Powers of a height that hardly changes could not be told apart.
    if abs(guess.rest) <= guess.amplitude:
        return HeightMap()
    return HeightMap(guess.rest, guess.amplitude)


def _words(method: str, form: str, ensemble: bool) -> str:
    if method != "sindy":
        return method
    return f"sindy, {form} form" + (", ensemble" if ensemble else "")


# Structures -------------------------------------------------------------------------------------


def _sindy_supports(
    weak: WeakForm, terms: Sequence[Term], form: str, ensemble: bool, seed: int
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
    weak: WeakForm, terms: Sequence[Term], supports: Sequence[Sequence[int]]
) -> list[np.ndarray]:
    """Supports, and all that backward elimination makes of them."""
    whitening = weak.whitening((), np.zeros(0))
    matrix, target = whitening @ weak.matrix(terms), whitening @ weak.target
    paths = (path for support in supports if support for path in pruned(matrix, target, support))
    return by_size(paths)


def _symbolic_candidates(
    weak: WeakForm, terms: Sequence[Term], method: str, seed: int
) -> tuple[list[CandidateEquation], Judge]:
    """Expressions of a symbolic regression; of sums of terms also what can be left out of them."""
    expressions = _expressions(weak.motions, method, seed)
    sums = [(one, terms_of(one)) for one in expressions]
    union = sorted({term for _, found in sums if found is not None for term in found})
    if not union or len(union) > _MOST_UNION:
        union = sorted(set(terms) | set(union))[:_MOST_UNION]
    place = {term: k for k, term in enumerate(union)}
    supports = [
        [place[term] for term in found if term in place] for _, found in sums if found is not None
    ]
    groups = _eliminated(weak, union, supports) or all_subsets(1)
    ranked, judge = scored(weak, terms, union, groups)
    candidates = [_candidate(one) for one in ranked]
    candidates += [_judged(one, judge) for one, found in sums if found is None]
    return candidates, judge


def _expressions(motions: Sequence[SmoothedMotion], method: str, seed: int) -> list[sympy.Expr]:
    import sympy

    _, v, _ = symbols()
    parts = [_search_samples(motion, len(motions)) for motion in motions]
    samples = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    target = samples.pop("target")
    noise = math.sqrt(sum(motion.acceleration_noise**2 for motion in motions) / len(motions))
    if method == "operon":
        from reduced_models.discovery.symbolic import operon_expressions

        found = operon_expressions(samples, target, noise, seed=seed)
    else:
        from reduced_models.discovery.julia import pysr_expressions

        found = pysr_expressions(samples, target, noise, seed=seed)
    replaced = {
        sympy.Symbol("speed", real=True): sympy.Abs(v),
        sympy.Symbol("direction", real=True): sympy.sign(v),
    }
    return [one.xreplace(replaced) for one in found]


def _search_samples(motion: SmoothedMotion, motions: int) -> dict[str, np.ndarray]:
    """What a symbolic regression sees of one of so many motions, away from its ends."""
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
    return {name: values[rows] for name, values in found.items()}


def _candidate(one: Scored) -> CandidateEquation:
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


# The choice -------------------------------------------------------------------------------------


def _polished(
    candidates: list[CandidateEquation],
    polish: Callable[[CandidateEquation], CandidateEquation],
    count: int,
    judge: Judge,
) -> tuple[list[CandidateEquation], int]:
    """The Pareto front, with all polished candidates, and the place of the chosen one."""
    order = sorted(candidates, key=lambda one: one.criterion)
    near = [one for one in order if one.criterion <= order[0].criterion + _HOPELESS][:count]
    done = _with_simpler_ones([polish(one) for one in near], polish, judge)
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
            simpler = _candidate(weighed(judge, needed))
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


def _needed_terms(candidate: CandidateEquation) -> list[Term]:
    """The terms whose coefficients' intervals leave out zero."""
    if candidate.model is None or candidate.terms is None:
        return []
    # The coefficients of a sum are named in the order of its terms.
    intervals = [candidate.model.intervals[f"c{k}"] for k in range(len(candidate.terms))]
    terms = zip(sorted(candidate.terms), intervals, strict=True)
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


def _notes(best: CandidateEquation, judge: Judge) -> tuple[str, ...]:
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
            f"the chosen equation leaves {left:.2g} times what the record's noise would: the "
            "law is not among those searched, so read it as a summary of this record"
        )
    if best.model is None and best.note:
        notes.append(f"the chosen equation was not polished: {best.note}")
    notes += [note for model in best.models for note in model.notes]
    return tuple(dict.fromkeys(notes))
