"""`fit`: the parameters of a law from a record, through the law's differential equation.

The whole motion is compared, not its derivatives: for trial parameters the equation is solved
from a fitted initial state, and Levenberg-Marquardt changes the parameters until the solution
lies on the record. Many random starts, first on the first two swings and then on all of the
record, keep it from settling in a wrong valley.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, overload

import numpy as np

from granular.run.record import PistonRecord
from granular.scene.schema import unknown
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.fitting.assessment import Training, models_of
from reduced_models.fitting.bootstrap import REPLICATES
from reduced_models.fitting.joint_vector import JointVector, joint_normal, joint_vector
from reduced_models.fitting.refinement import JointRecords, judged_fit
from reduced_models.fitting.start_vectors import (
    free_entries,
    start_vectors,
    started,
    swing_draws,
    swing_unknowns,
    unknowns_of,
)
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law, law_from_text
from reduced_models.laws.solution import grid_steps
from reduced_models.least_squares.levenberg_marquardt import (
    TIE,
    Bounds,
    Normal,
    Prior,
    agreement,
    search,
)
from reduced_models.least_squares.residuals import BLOWN_UP, gridded, residual_functions
from reduced_models.least_squares.samples import Samples, means_on_grid
from reduced_models.least_squares.unknowns import Unknowns, theta_bounds
from reduced_models.models.model import ReducedModel
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.inputs import column_names, drive_on_grid

STARTS = 16
HOLDOUT = 0.3
_FIRST_SWINGS = 2.0
_FIRST_TRIALS, _FIRST_TOLERANCE = 60, 1e-4
_RIVAL_TRIALS = 20  # of a law as it stands, beside its fit with a map
_HOPELESS = 4.0  # times the cost of the fit with a map
MOST_STARTS = 10_000
"""Ten times a thousand, with which a short record takes minutes."""
_MOST_NUMBERS = 2**26
"""Starts times grid points times unknowns, which stand in memory four times: two gigabytes."""
COARSE_STEPS, FINE_STEPS = 16, 64
"""Grid steps of a period: the phase error of a period is then 4e-6 and 1e-9."""

Pairs = Mapping[str, tuple[float, float]]


@overload
def fit(
    record: PistonRecord,
    law: str | Law = ...,
    *,
    map: HeightMap | Literal["auto", "fitted"] = ...,
    starts: int = ...,
    holdout: float = ...,
    confidence: float = ...,
    seed: int = ...,
    own: Sequence[str] = ...,
    bounds: Pairs | None = ...,
    intervals: Literal["linear", "bootstrap", "profile"] = ...,
) -> ReducedModel: ...


@overload
def fit(
    record: Sequence[PistonRecord],
    law: str | Law = ...,
    *,
    map: HeightMap | Literal["auto", "fitted"] = ...,
    starts: int = ...,
    holdout: float = ...,
    confidence: float = ...,
    seed: int = ...,
    own: Sequence[str] = ...,
    bounds: Pairs | None = ...,
    intervals: Literal["linear", "bootstrap", "profile"] = ...,
) -> tuple[ReducedModel, ...]: ...


def fit(
    record: PistonRecord | Sequence[PistonRecord],
    law: str | Law = "van-der-pol-like",
    *,
    map: HeightMap | Literal["auto", "fitted"] = "auto",  # noqa: A002
    starts: int = STARTS,
    holdout: float = HOLDOUT,
    confidence: float = 0.95,
    seed: int = 0,
    own: Sequence[str] = (),
    bounds: Pairs | None = None,
    intervals: Literal["linear", "bootstrap", "profile"] = "linear",
) -> ReducedModel | tuple[ReducedModel, ...]:
    """Fit a law to a record, or to several at once.

    Parameters
    ----------
    record : PistonRecord, or a sequence of them
        Samples may be irregular and have gaps.
    law : str or Law
        A law of the package by its name, an equation such as ``"z'' + 2*lam*z' + k*z = g0"``, or a
        Law. Names in an equation that are columns of the record are inputs; all others are
        parameters.
    map : HeightMap, "auto" or "fitted"
        How the height enters a law that has a map (``law.mapped``): as given, fitted, or fitted
        unless the record is described as well with z = height (Bayesian information criterion).
    starts : int
        Random starts.
    holdout : float
        Fraction of each record, at its end, that is held out: first guesses, the choice of the map
        and a first model do without it, and that model is judged on it. The model that is given
        back is then fitted to all of the record. 0 for none.
    confidence : float
        Of the intervals.
    seed : int
        Of all that is random: the starts, and the records that a bootstrap draws.
    own : sequence of str
        Parameters that each of several records has for itself; the others are shared. Every record
        has its own initial state.
    bounds : mapping of str to (float, float), optional
        Least and greatest value of parameters.
    intervals : "linear", "bootstrap" or "profile"
        From the linearisation at the best fit, by fitting resampled records, or by holding each
        parameter at values further and further away and fitting the others again: right also
        where parameters are bounded or trade places (see `reduced_models.fitting.profile`).
        Intervals of the small swing at rest are always those of the linearisation.

    Returns
    -------
    ReducedModel, or a tuple of them
        One for each record.

    Raises
    ------
    RecordError
        If a record is too short, does not move, or lacks a column that is an input of the law.
    InputError
        If an argument is out of its range, no start led to a solution that stays finite, or the
        solution cannot be followed to the accuracy that the fit needs.

    Warns
    -----
    UserWarning
        For each of the model's notes: where few starts agree, a parameter lies at its bound, or the
        law leaves over much more than the record's noise.
    """
    records = [record] if isinstance(record, PistonRecord) else list(record)
    if not records:
        raise InputError("there is no record to fit; give at least one")
    if not isinstance(map, HeightMap) and map not in ("auto", "fitted"):
        raise InputError(f"map = {quoted(map)}; give 'auto', 'fitted' or a HeightMap")
    if intervals not in ("linear", "bootstrap", "profile"):
        raise InputError(
            f"intervals = {quoted(intervals)}; give 'linear', 'bootstrap' or 'profile'"
        )
    check_options(starts, holdout, confidence)
    chosen = law_of(law, records[0])
    _check_names(chosen, own, bounds or {})
    case = _case(records, holdout, own, bounds or {})
    best = _best(chosen, map, case, starts, seed)
    if not math.isfinite(_information(best)):
        raise InputError(
            f"no start led to a solution of {quoted(chosen.name)} that stays finite over the "
            "record; try "
            "another law, more starts or a shorter record"
        )
    found = judged_fit(best.joint, best.theta, case.samples)
    training = Training(
        samples=case.samples,
        stops=tuple(data.stop for data in case.data),
        starts=starts,
        converged=best.converged,
        confidence=confidence,
        bounds=case.bounds,
        replicates=REPLICATES if intervals == "bootstrap" else 0,
        profile=intervals == "profile",
        seed=seed,
    )
    models = models_of(found, training)
    for note in dict.fromkeys(note for model in models for note in model.notes):
        warnings.warn(f"fit of {chosen.name}: {note}", stacklevel=2)
    return models[0] if isinstance(record, PistonRecord) else models


def law_of(law: str | Law, record: PistonRecord) -> Law:
    """A law by its name, its equation, or as it is.

    Raises
    ------
    InputError
        If there is no such law, or the text is no equation of motion.
    """
    if isinstance(law, Law):
        return law
    if "=" in law or "'" in law:
        return law_from_text(law, column_names(record))
    return law_named(law)


def check_options(starts: int = STARTS, holdout: float = HOLDOUT, confidence: float = 0.95) -> None:
    """Raise `InputError` unless the options of `fit` are in their ranges."""
    if not isinstance(starts, int) or isinstance(starts, bool) or not 1 <= starts <= MOST_STARTS:
        raise InputError(f"starts = {quoted(starts)}; give a whole number from 1 to {MOST_STARTS}")
    if not 0.0 <= holdout <= 0.9:
        raise InputError(f"holdout = {quoted(holdout)}; give a fraction from 0 to 0.9")
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence = {quoted(confidence)}; give a fraction between 0 and 1")


def _check_names(law: Law, own: Sequence[str], bounds: Pairs) -> None:
    for name in (*own, *bounds):
        if name not in law.parameters:
            raise InputError(unknown(name, law.parameters, "parameter"))
    for name, (low, high) in bounds.items():
        if not low < high:
            raise InputError(f"bounds of {name}: {low:g} is not below {high:g}; give them in order")
        if name in law.positive and high <= 0.0:
            raise InputError(
                f"bounds of {name}: up to {high:g}, and the law holds for values above 0; raise it"
            )


class _Data(NamedTuple):
    """A record from time 0 on, the stretch of it that a fit may see first, and a glance at that."""

    record: PistonRecord
    training: PistonRecord
    stop: float
    guess: FirstGuesses


class _Case(NamedTuple):
    """Records to fit together; the one that swings the furthest sets the scales."""

    data: tuple[_Data, ...]
    own: Sequence[str]
    bounds: Pairs

    @property
    def leader(self) -> _Data:
        return max(self.data, key=lambda data: data.guess.amplitude)

    @property
    def samples(self) -> tuple[int, ...]:
        return tuple(len(data.training) for data in self.data)


def _case(
    records: Sequence[PistonRecord], holdout: float, own: Sequence[str], bounds: Pairs
) -> _Case:
    return _Case(tuple(_split(each, holdout) for each in records), own, bounds)


def _split(record: PistonRecord, holdout: float) -> _Data:
    whole = record.from_zero()
    stop = float(whole.time[-1]) * (1.0 - holdout)
    # Two samples make a record; what is too short to fit is told by its first guesses.
    count = max(2, int(np.searchsorted(whole.time, stop, side="right")))
    training = whole.first(count)
    return _Data(whole, training, stop, first_guesses(training))


class _Candidate(NamedTuple):
    """A law with one way to map the height, fitted to the training stretches.

    Attributes
    ----------
    joint : JointRecords
        Of the whole records.
    theta : float64 (p,)
    samples, converged : int
        Of the training stretches; starts that led to this fit.
    cost : float
        Sum of the squared training residuals; infinite where the solution blows up.
    coarse_cost : float
        The same of the means on the search's coarse grid.
    """

    joint: JointRecords
    theta: np.ndarray
    samples: int
    converged: int
    cost: float
    coarse_cost: float


def _best(law: Law, wanted: HeightMap | str, case: _Case, starts: int, seed: int) -> _Candidate:
    """The law with the map that is asked for, or that the data ask for."""
    if not law.mapped or isinstance(wanted, HeightMap):
        given = wanted if isinstance(wanted, HeightMap) and law.mapped else HeightMap()
        return _refined(case, _searched(law, given, case, starts, seed))
    found = _refined(case, _searched(law, None, case, starts, seed))
    if wanted == "fitted":
        return found
    limit = _HOPELESS * found.coarse_cost
    rival = _searched(law, HeightMap(), case, starts, seed, limit)
    if rival.costs.min() > limit:
        return found
    return min(_refined(case, rival), found, key=_information)


class _Search(NamedTuple):
    """Where the starts led to on coarse grids: vectors (s, p) and costs (s,)."""

    unknowns: Unknowns
    vector: JointVector
    bounds: Bounds
    theta: np.ndarray
    costs: np.ndarray


def _searched(
    law: Law,
    height_map: HeightMap | None,
    case: _Case,
    starts: int,
    seed: int,
    limit: float = math.inf,
) -> _Search:
    """Search from random starts: on the first swings, then on whole training stretches.

    The second is left out where even the first swings alone cost more than the limit.
    """
    # First of all: a record with too many periods is refused before any search.
    _fine_steps(law, case)
    unknowns = unknowns_of(law, height_map, case.leader.guess, case.leader.training)
    vector = joint_vector(unknowns, len(case.data), case.own)
    bounds = Bounds(*(vector.joined(edge) for edge in theta_bounds(unknowns, case.bounds)))
    coarse = [_coarse(unknowns, data) for data in case.data]
    _check_memory(starts, max(len(one.weight) for one in coarse), len(vector.places[0]))
    theta = _swung(unknowns, vector, case, coarse, starts, seed)
    if theta is None:
        theta = vector.merged(_start_vectors(unknowns, case, starts, seed))
        normal, prior = _coarse_normal(unknowns, vector, case, coarse, _FIRST_SWINGS)
        trials = _FIRST_TRIALS if math.isinf(limit) else _RIVAL_TRIALS
        theta, costs = search(normal, theta, prior, _FIRST_TOLERANCE, bounds, trials=trials)
        if costs.min() > limit:
            return _Search(unknowns, vector, bounds, theta, costs)
    normal, prior = _coarse_normal(unknowns, vector, case, coarse, math.inf)
    return _Search(unknowns, vector, bounds, *search(normal, theta, prior, bounds=bounds))


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Refuse a search that needs more memory than a laboratory's computer has to spare."""
    most = _MOST_NUMBERS // (points * unknowns)
    if starts > max(most, STARTS):
        raise InputError(
            f"starts = {starts}; at most {most} fit into memory for {unknowns} unknowns and a "
            f"record that needs {points} steps: give fewer, or a shorter record"
        )


def _swung(
    unknowns: Unknowns,
    vector: JointVector,
    case: _Case,
    coarse: Sequence[Samples],
    starts: int,
    seed: int,
) -> np.ndarray | None:
    """Start vectors of a mapped law where random starts of its swing form lead to."""
    form, leader = unknowns.law.swing_form, case.leader
    if form is None or unknowns.map is not None or case.own or case.bounds:
        return None
    random = np.random.default_rng(seed)
    draws = swing_draws(form, leader.guess, leader.training, starts, random)
    if draws is None:
        return None
    swinging = swing_unknowns(unknowns, form, draws)
    free = free_entries(swinging, draws)
    theta = vector.merged([started(swinging, data.guess, free) for data in case.data])
    for swings in (_FIRST_SWINGS, math.inf):
        normal, prior = _coarse_normal(swinging, vector, case, coarse, swings)
        theta, _ = search(normal, theta, prior, _FIRST_TOLERANCE, trials=_FIRST_TRIALS)
    values = swinging.physical(theta[:, vector.places[0]].T)[0]
    mapped = form.mapped(dict(zip(form.law.parameters, values, strict=True)))
    theta[:, : free.shape[1]] = free_entries(unknowns, mapped)
    return theta


def _fine_steps(law: Law, case: _Case) -> list[int]:
    """Steps of the fine grid over each record."""
    wanted = law.resolution * FINE_STEPS
    return [
        grid_steps(float(data.record.time[-1]), data.guess.period, wanted) for data in case.data
    ]


def _coarse(unknowns: Unknowns, data: _Data) -> Samples:
    """Means of a training stretch on a coarse grid."""
    training = data.training
    wanted = unknowns.law.resolution * COARSE_STEPS
    steps = grid_steps(float(training.time[-1]), data.guess.shortest_period, wanted)
    drive = drive_on_grid(training, unknowns.law.inputs, steps)
    return means_on_grid(training.time, training.height, steps, drive)


def _coarse_normal(
    unknowns: Unknowns, vector: JointVector, case: _Case, coarse: Sequence[Samples], swings: float
) -> tuple[Normal, Prior]:
    """The normal equations of the first swings, and the prior about the starts."""
    normals, total = [], 0.0
    for data, means in zip(case.data, coarse, strict=True):
        seen = means.step * np.arange(len(means.weight)) <= swings * data.guess.period
        weight = means.weight * seen
        total += float((weight**2).sum())
        seen_means = means._replace(weight=weight)
        normals.append(residual_functions(unknowns).of(seen_means, unknowns.scales))
    return joint_normal(normals, vector), Prior(vector.joined(unknowns.prior), total)


def _refined(case: _Case, found: _Search) -> _Candidate:
    """The best start of a search, sharpened on fine grids."""
    grids = [
        gridded(found.unknowns, data.record, steps)
        for data, steps in zip(case.data, _fine_steps(found.unknowns.law, case), strict=True)
    ]
    joint = JointRecords(tuple(grids), found.vector, found.bounds)
    count = sum(case.samples)
    converged = int((found.costs <= agreement(found.costs, count)).sum())
    best = joint.sharpened(found.theta[int(found.costs.argmin())], case.samples)
    residuals = np.concatenate(
        [each[:size] for each, size in zip(joint.residuals(best), case.samples, strict=True)]
    )
    finite = bool((np.abs(residuals) < BLOWN_UP).all())
    cost = float(residuals @ residuals) if finite else math.inf
    return _Candidate(joint, best, count, converged, cost, float(found.costs.min()))


def _start_vectors(unknowns: Unknowns, case: _Case, starts: int, seed: int) -> list[np.ndarray]:
    """Start vectors (starts, p) of each record; the first one's parameters are the leader's."""
    found = [
        start_vectors(unknowns, data.guess, data.training, starts, np.random.default_rng(seed))
        for data in case.data
    ]
    leader = found[case.data.index(case.leader)]
    shared = slice(0, -2)
    found[0] = found[0].copy()
    keep = [unknowns.law.parameters.index(name) for name in case.own]
    own = found[0][:, keep].copy()
    found[0][:, shared] = leader[:, shared]
    found[0][:, keep] = own
    return found


def _information(found: _Candidate) -> float:
    """Bayesian information criterion; residuals below the tie level count as equal."""
    mean = max(found.cost / found.samples, TIE**2)
    return found.samples * math.log(mean) + len(found.theta) * math.log(found.samples)
