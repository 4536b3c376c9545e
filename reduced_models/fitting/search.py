"""The search of a fit: many starts, over horizons that double.

Whoever fits all of a long record at once falls into the valleys in which the solution gains or
loses a whole swing. Here the first two swings are fitted, then four, eight, sixteen, until all of
the training stretch is seen: at each doubling, the phase at the new end is known to a fraction of a
swing from what was fitted before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.shared.errors import InputError
from reduced_models.fitting.candidate import Candidate, Searched, fine_grids, refined
from reduced_models.fitting.case import Case
from reduced_models.fitting.horizons import (
    FIRST_SWINGS,
    Coarse,
    coarse_normal,
    coarse_record,
    horizons,
)
from reduced_models.fitting.joint_vector import JointVector, joint_vector
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
from reduced_models.least_squares.levenberg_marquardt import (
    TIE,
    Bounds,
    Normal,
    in_the_running,
    search,
)
from reduced_models.least_squares.unknowns import Unknowns, theta_bounds

_TRIALS, _TOLERANCE = 60, 1e-4  # of all horizons but the last: what lags behind loses its phase
_RIVAL_TRIALS = 20  # of a law as it stands, beside its fit with a map
_HOPELESS = 4.0  # times the cost of the fit with a map
_FREER = 1.5  # times the cost of the swing form: more is the law's own, or another valley
_POOR = 0.05  # of the amplitude: what is left over where even the swing form may be in a wrong one
_MOST_NUMBERS = 2**26
"""Starts times grid points times unknowns, which stand in memory four times: two gigabytes."""


def best_candidate(
    law: Law, wanted: HeightMap | str, case: Case, starts: int, seed: int
) -> Candidate:
    """The law with the map that is asked for, or that the data ask for."""
    if not law.mapped or isinstance(wanted, HeightMap):
        given = wanted if isinstance(wanted, HeightMap) and law.mapped else HeightMap()
        return refined(case, _searched(law, given, case, starts, seed))
    found = refined(case, _searched(law, None, case, starts, seed))
    if wanted == "fitted":
        return found
    limit = _HOPELESS * found.coarse_cost
    rival = _searched(law, HeightMap(), case, starts, seed, limit)
    if rival.costs.min() > limit:
        return found
    return min(refined(case, rival), found, key=information)


def _searched(
    law: Law,
    height_map: HeightMap | None,
    case: Case,
    starts: int,
    seed: int,
    limit: float = math.inf,
) -> Searched:
    """Search from random starts over horizons that double.

    All but the first are left out where even that costs more than the limit. Starts of the law's
    swing form come first; where the law leaves over more than that form does, which is free of
    the law's bounds, they may lie in the wrong valley, and starts of the law itself are tried too.
    """
    # First of all: a record with too many periods is refused before any search.
    fine_grids(law, case)
    unknowns = unknowns_of(law, height_map, case.leader.guess, case.leader.look)
    vector = joint_vector(unknowns, len(case.data), case.own)
    edges = [theta_bounds(unknowns, case.bounds_of(data), case.initial) for data in case.data]
    bounds = Bounds(*(vector.merged(side) for side in zip(*edges, strict=True)))
    coarse = [coarse_record(unknowns, case, data) for data in case.data]
    _check_memory(starts, max(len(one.means.weight) for one in coarse), len(vector.places[0]))
    swung = _swung(unknowns, vector, case, coarse, starts, seed)
    if swung is not None:
        theta, least = swung
        normal, prior = coarse_normal(unknowns, vector, case, coarse, math.inf)
        found = search(normal, theta, prior, bounds=bounds)
        poor = prior.samples * _POOR**2
        if found[1].min() > min(max(_FREER * least, prior.samples * TIE**2), poor):
            other = _over_horizons(unknowns, vector, case, coarse, bounds, starts, seed, limit)
            found = min(found, other, key=lambda one: float(one[1].min()))
    else:
        found = _over_horizons(unknowns, vector, case, coarse, bounds, starts, seed, limit)
    reached = tuple(one.end for one in coarse)
    return Searched(unknowns, vector, bounds, *found, reached)


def _over_horizons(
    unknowns: Unknowns,
    vector: JointVector,
    case: Case,
    coarse: Sequence[Coarse],
    bounds: Bounds,
    starts: int,
    seed: int,
    limit: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Where random starts of a law lead to, and what that costs."""
    theta = vector.merged(_start_vectors(unknowns, case, starts, seed))
    costs, begun = np.zeros(starts), theta
    for swings in horizons(coarse):
        first, last = swings == FIRST_SWINGS, math.isinf(swings)
        normal, prior = coarse_normal(unknowns, vector, case, coarse, swings)
        if unknowns.law.start is None and not first:
            theta = _better(normal, theta, begun)
        rival = first and not math.isinf(limit)
        trials = _RIVAL_TRIALS if rival else _TRIALS
        if last:
            waiting = None if not costs.any() else in_the_running(costs, prior.samples)
            theta, costs = search(normal, theta, prior, bounds=bounds, waiting=waiting)
        else:
            waiting = None if first else in_the_running(costs, prior.samples)
            theta, costs = search(
                normal, theta, prior, _TOLERANCE, bounds, trials=trials, waiting=waiting
            )
        if rival and costs.min() > limit:
            break
    return theta, costs


def _better(normal: Normal, theta: np.ndarray, begun: np.ndarray) -> np.ndarray:
    """What fewer swings made of the starts, or the starts themselves where these fit better.

    Those of a law that is known by its equation alone come from all of the record: two swings may
    say nothing of what they tell, such as the frequency of a slow input.
    """
    worse = np.asarray(normal(begun)[0]) < np.asarray(normal(theta)[0])
    return np.where(worse[:, None], begun, theta)


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
    coarse: Sequence[Coarse],
    starts: int,
    seed: int,
) -> tuple[np.ndarray, float] | None:
    """Start vectors of a mapped law where random starts of its swing form lead to; its cost."""
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
    for swings in horizons(coarse):
        normal, prior = coarse_normal(swinging, vector, case, coarse, swings)
        theta, costs = search(normal, theta, prior, _TOLERANCE, trials=_TRIALS)
    values = swinging.physical(theta[:, vector.places[0]].T)[0]
    mapped = form.mapped(dict(zip(form.law.parameters, values, strict=True)))
    theta[:, : free.shape[1]] = free_entries(unknowns, mapped)
    return theta, float(costs.min())


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
            case.bounds_of(data),
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
