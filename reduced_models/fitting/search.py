"""The search of a fit: many starts, over horizons that double.

Whoever fits all of a long record at once falls into the valleys in which the solution gains or
loses a whole swing. Here the first two swings are fitted, then four, eight, sixteen, until all of
the training stretch is seen: at each doubling, the phase at the new end is known to a fraction of a
swing from what was fitted before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError
from reduced_models.fitting.case import Case, Data
from reduced_models.fitting.joint_vector import JointVector, joint_normal, joint_vector
from reduced_models.fitting.refinement import JointRecords
from reduced_models.fitting.start_values import matched_values
from reduced_models.fitting.start_vectors import (
    free_entries,
    start_vectors,
    started,
    swing_draws,
    swing_unknowns,
    unknowns_of,
)
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.laws.symmetry import at_home
from reduced_models.least_squares.levenberg_marquardt import (
    TIE,
    Bounds,
    Normal,
    Prior,
    agreement,
    in_the_running,
    search,
)
from reduced_models.least_squares.residuals import (
    BLOWN_UP,
    cost_and_weight,
    gridded,
    residual_functions,
)
from reduced_models.least_squares.samples import (
    Samples,
    grid_over,
    means_on_grid,
    samples_on_grid,
)
from reduced_models.least_squares.unknowns import Unknowns, theta_bounds
from reduced_models.records.inputs import Grid, driving

FIRST_SWINGS = 2.0
_TRIALS, _TOLERANCE = 60, 1e-4  # of all horizons but the last: what lags behind loses its phase
_RIVAL_TRIALS = 20  # of a law as it stands, beside its fit with a map
_HOPELESS = 4.0  # times the cost of the fit with a map
_MOST_NUMBERS = 2**26
"""Starts times grid points times unknowns, which stand in memory four times: two gigabytes."""
COARSE_STEPS, FINE_STEPS = 16, 64
"""Grid steps of a period: the phase error of a period is then 4e-6 and 1e-9."""
_MOST_COARSE = 2**13  # steps over which all starts are followed; behind them, the best one
_THIN = 2.0  # samples a coarse step, above which their means are fitted
_SAME_VALLEY = 2.0  # times the cost of the fit
_TELLING = 1e-4  # of a cost: tolerance of a fit that is only compared
_BETTER = 0.99  # of a cost: less is another fit


class Candidate(NamedTuple):
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
    collocation : str
        Where the fit from accelerations in the record, without a solution, led to: ``"same"``,
        ``"worse"``, ``"better"`` (which is then this fit), or ``"none"`` where there is none.
    """

    joint: JointRecords
    theta: np.ndarray
    samples: int
    converged: int
    cost: float
    coarse_cost: float
    collocation: str = "none"


def best_candidate(
    law: Law, wanted: HeightMap | str, case: Case, starts: int, seed: int
) -> Candidate:
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
    return min(_refined(case, rival), found, key=information)


class _Search(NamedTuple):
    """Where the starts led to on coarse grids: vectors (s, p) and costs (s,).

    ``reached`` is the time up to which each record was seen.
    """

    unknowns: Unknowns
    vector: JointVector
    bounds: Bounds
    theta: np.ndarray
    costs: np.ndarray
    reached: tuple[float, ...]


class _Coarse(NamedTuple):
    """A record's means on a coarse grid, over the part of it that all starts follow."""

    data: Data
    means: Samples
    end: float


def _searched(
    law: Law,
    height_map: HeightMap | None,
    case: Case,
    starts: int,
    seed: int,
    limit: float = math.inf,
) -> _Search:
    """Search from random starts over horizons that double.

    All but the first are left out where even that costs more than the limit.
    """
    # First of all: a record with too many periods is refused before any search.
    fine_grids(law, case)
    unknowns = unknowns_of(law, height_map, case.leader.guess, case.leader.look)
    vector = joint_vector(unknowns, len(case.data), case.own)
    edges = [theta_bounds(unknowns, case.bounds_of(data), case.initial) for data in case.data]
    bounds = Bounds(*(vector.merged(side) for side in zip(*edges, strict=True)))
    coarse = [_coarse(unknowns, case, data) for data in case.data]
    _check_memory(starts, max(len(one.means.weight) for one in coarse), len(vector.places[0]))
    swung = _swung(unknowns, vector, case, coarse, starts, seed)
    if swung is None:
        theta = vector.merged(_start_vectors(unknowns, case, starts, seed))
        horizons = _horizons(coarse)
    else:
        theta, horizons = swung, iter([math.inf])
    costs = np.zeros(starts)
    for swings in horizons:
        first, last = swings == FIRST_SWINGS, math.isinf(swings)
        normal, prior = _coarse_normal(unknowns, vector, case, coarse, swings)
        rival = first and not math.isinf(limit)
        trials = _RIVAL_TRIALS if rival else _TRIALS
        if last:
            waiting = None if swung is not None or not costs.any() else in_the_running(
                costs, prior.samples
            )  # fmt: skip
            theta, costs = search(normal, theta, prior, bounds=bounds, waiting=waiting)
        else:
            waiting = None if first else in_the_running(costs, prior.samples)
            theta, costs = search(
                normal, theta, prior, _TOLERANCE, bounds, trials=trials, waiting=waiting
            )
        if rival and costs.min() > limit:
            break
    reached = tuple(one.end for one in coarse)
    return _Search(unknowns, vector, bounds, theta, costs, reached)


def _horizons(coarse: Sequence[_Coarse]) -> Iterator[float]:
    """Swings that a search sees one after the other; infinitely many are all of them."""
    most = max(one.end / one.data.guess.quickest for one in coarse)
    swings = FIRST_SWINGS
    while swings < most:
        yield swings
        swings *= 2.0
    yield math.inf


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Refuse a search that needs more memory than a laboratory's computer has to spare."""
    most = _MOST_NUMBERS // (points * unknowns)
    if starts > max(most, 16):
        raise InputError(
            f"starts = {starts}; at most {most} fit into memory for {unknowns} unknowns and a "
            f"record that needs {points} steps: give fewer, or a shorter record"
        )


def _swung(
    unknowns: Unknowns,
    vector: JointVector,
    case: Case,
    coarse: Sequence[_Coarse],
    starts: int,
    seed: int,
) -> np.ndarray | None:
    """Start vectors of a mapped law where random starts of its swing form lead to."""
    form, leader = unknowns.law.swing_form, case.leader
    if form is None or unknowns.map is not None or case.own or case.bounds or case.start:
        return None
    random = np.random.default_rng(seed)
    draws = swing_draws(form, leader.guess, leader.look, starts, random)
    if draws is None:
        return None
    swinging = swing_unknowns(unknowns, form, draws)
    free = free_entries(swinging, draws)
    theta = vector.merged([started(swinging, data.guess, free) for data in case.data])
    for swings in _horizons(coarse):
        normal, prior = _coarse_normal(swinging, vector, case, coarse, swings)
        theta, _ = search(normal, theta, prior, _TOLERANCE, trials=_TRIALS)
    values = swinging.physical(theta[:, vector.places[0]].T)[0]
    mapped = form.mapped(dict(zip(form.law.parameters, values, strict=True)))
    theta[:, : free.shape[1]] = free_entries(unknowns, mapped)
    return theta


def fine_grids(law: Law, case: Case) -> list[Grid]:
    """The fine grid over each record.

    One of a driven law, whose steps end at the samples, is no finer than need be at first.
    """
    wanted = law.resolution * (COARSE_STEPS if driving(law.inputs) else FINE_STEPS)
    return [
        grid_over(data.record, law.inputs, data.guess.period, wanted, case.interpolation)
        for data in case.data
    ]


def _coarse(unknowns: Unknowns, case: Case, data: Data) -> _Coarse:
    """Means of a training stretch, or of its first part, on a coarse grid."""
    training, law = data.training, unknowns.law
    wanted = law.resolution * COARSE_STEPS
    period = data.guess.shortest_period
    grid = grid_over(training, law.inputs, period, wanted, case.interpolation)
    if grid.steps > _MOST_COARSE:
        count = int(np.searchsorted(training.time, grid.step * _MOST_COARSE, side="right"))
        training = training.first(count)
        grid = grid_over(training, law.inputs, period, wanted, case.interpolation)
    weights = data.weights[: len(training)]
    end = float(training.time[-1])
    if driving(law.inputs) or len(training) > _THIN * grid.steps:
        means = means_on_grid(training, grid, law.inputs, case.interpolation, weights)
        return _Coarse(data, means, end)
    # A mean of few samples is moved to its grid point by the slope between them, which is off
    # where they are far apart: by as much as the noise, which the doubling does not survive.
    samples = samples_on_grid(training, grid, law.inputs, case.interpolation)
    padded = np.zeros_like(samples.weight)
    padded[: len(training)] = weights
    return _Coarse(data, samples.weighted(padded), end)


def _coarse_normal(
    unknowns: Unknowns,
    vector: JointVector,
    case: Case,
    coarse: Sequence[_Coarse],
    swings: float,
) -> tuple[Normal, Prior]:
    """The normal equations of the first swings, and the prior about the starts."""
    normals, total = [], 0.0
    for data, means, _ in coarse:
        seen = means.step * (means.place + means.share) <= swings * data.guess.quickest
        weight = means.weight * seen
        total += float((weight**2).sum())
        loss = case.loss_of(data, unknowns.amplitude)
        seen_means = means.weighted(weight)
        normals.append(residual_functions(unknowns).of(seen_means, unknowns.scales, loss))
    return joint_normal(normals, vector), Prior(vector.joined(unknowns.prior), total)


def _refined(case: Case, found: _Search) -> Candidate:
    """The best start of a search, sharpened on fine grids, beside the collocation's estimate."""
    unknowns = found.unknowns
    grids = [
        gridded(
            unknowns, data.record, grid, case.interpolation, data.weights,
            case.loss_of(data, unknowns.amplitude),
        )
        for data, grid in zip(case.data, fine_grids(unknowns.law, case), strict=True)
    ]  # fmt: skip
    joint = JointRecords(tuple(grids), found.vector, found.bounds)
    count = sum(case.samples)
    first = _at_home(joint, case, found.theta[int(found.costs.argmin())])
    best = _along(joint, case, first, found.reached)
    cost, coarse_cost = _cost(joint, case, best), float(found.costs.min())
    other = _collocated(joint, case, best)
    collocation = "none"
    if other is not None:
        tie = count * TIE**2
        other_cost = _cost(joint, case, other)
        collocation = "same" if other_cost * _BETTER <= cost + tie else "worse"
        if other_cost + tie < _BETTER * cost:
            coarse_cost *= other_cost / cost
            best = joint.sharpened(other, case.samples)
            cost, collocation = _cost(joint, case, best), "better"
    limit = agreement(np.array([coarse_cost]), count)
    converged = int((found.costs <= limit).sum())
    return Candidate(joint, best, count, converged, cost, coarse_cost, collocation)


def _at_home(joint: JointRecords, case: Case, theta: np.ndarray) -> np.ndarray:
    """A search vector that means the same, its angles and signs at home."""
    unknowns = joint.unknowns
    kept = {*case.own, *case.bounds}
    theta = theta.copy()
    here = joint.vector.places[0][: len(unknowns.law.parameters)]
    values = dict(
        zip(
            unknowns.law.parameters,
            unknowns.physical(theta[joint.vector.places[0]])[0],
            strict=True,
        )
    )
    moved = at_home(unknowns.law, values, kept)
    for place, name, unit in zip(here, unknowns.law.parameters, unknowns.units, strict=True):
        if moved[name] != values[name]:
            theta[place] = moved[name] / unit
    return theta


def _cost(joint: JointRecords, case: Case, theta: np.ndarray) -> float:
    """Of the training stretches; infinite where the solution blows up."""
    total = 0.0
    here = zip(joint.grids, joint.vector.places, case.samples, strict=True)
    for grid, place, size in here:
        left = grid.residuals(theta[place])[:size]
        if (np.abs(left) >= BLOWN_UP).any():
            return math.inf
        weighted = left * grid.weights[:size]
        total += float(cost_and_weight(weighted, grid.loss.numbers, np)[0].sum())
    return total


def _along(
    joint: JointRecords,
    case: Case,
    theta: np.ndarray,
    reached: Sequence[float],
    tolerance: float = 1e-11,
) -> np.ndarray:
    """A search vector sharpened on the fine grids, from a time on that it has seen."""
    share = min(
        end / float(one.training.time[-1]) for end, one in zip(reached, case.data, strict=True)
    )
    while share < 0.999:
        counts = [
            max(4, int(np.searchsorted(one.training.time, share * one.training.time[-1])))
            for one in case.data
        ]
        theta = joint.sharpened(theta, counts, tolerance=max(tolerance, 1e-6))
        share *= 2.0
    return joint.sharpened(theta, case.samples, tolerance=tolerance)


def _collocated(joint: JointRecords, case: Case, theta: np.ndarray) -> np.ndarray | None:
    """The fit that starts from accelerations in the leading record; None where there are none."""
    unknowns, leader = joint.unknowns, case.leader
    if unknowns.map is None or unknowns.law.hidden or case.own:
        return None
    given = unknowns.map
    seen = leader.guess.seen_as(given.shift, given.scale)
    mapped = leader.look.mapped(given.shift, given.scale)
    values = np.array(unknowns.physical(theta[joint.vector.places[0]])[0])
    held = case.held(leader)
    found = matched_values(unknowns.law, seen, mapped, values, held)
    free = free_entries(
        unknowns, {name: found[None, k] for k, name in enumerate(unknowns.law.parameters)}
    )
    start = joint.vector.merged([started(unknowns, data.guess, free) for data in case.data])[0]
    start = np.clip(start, *joint.bounds)
    if not np.isfinite(start).all():
        return None
    # Beside the fit's own start of the motion: what lies in its valley need not go a long way.
    beside = theta.copy()
    for here in joint.vector.places:
        beside[here[: unknowns.free]] = start[here[: unknowns.free]]
    if _cost(joint, case, beside) <= _SAME_VALLEY * _cost(joint, case, theta):
        return joint.sharpened(beside, case.samples, tolerance=_TELLING)
    reached = [FIRST_SWINGS * data.guess.quickest for data in case.data]
    return _along(joint, case, start, reached, _TELLING)


def _start_vectors(unknowns: Unknowns, case: Case, starts: int, seed: int) -> list[np.ndarray]:
    """Start vectors (starts, p) of each record; the first one's parameters are the leader's."""
    found = [
        start_vectors(
            unknowns,
            data.guess,
            data.look,
            starts,
            np.random.default_rng(seed),
            case.start,
            case.held(data),
        )
        for data in case.data
    ]
    leader = found[case.data.index(case.leader)]
    shared = slice(0, unknowns.free)
    found[0] = found[0].copy()
    keep = [unknowns.law.parameters.index(name) for name in case.own]
    own = found[0][:, keep].copy()
    found[0][:, shared] = leader[:, shared]
    found[0][:, keep] = own
    return found


def information(found: Candidate) -> float:
    """Bayesian information criterion; residuals below the tie level count as equal."""
    mean = max(found.cost / found.samples, TIE**2)
    return found.samples * math.log(mean) + len(found.theta) * math.log(found.samples)
