"""The best start of a search, sharpened on fine grids, beside what accelerations lead to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reduced_models.fitting.case import Case
from reduced_models.fitting.horizons import COARSE_STEPS, FIRST_SWINGS
from reduced_models.fitting.joint_vector import JointVector, joint_normal
from reduced_models.fitting.refinement import JointRecords
from reduced_models.fitting.start_values import matched_values
from reduced_models.fitting.start_vectors import free_entries, started
from reduced_models.laws.law import Law
from reduced_models.laws.symmetry import at_home
from reduced_models.least_squares.levenberg_marquardt import TIE, Bounds, agreement
from reduced_models.least_squares.residuals import BLOWN_UP, cost_and_weight, gridded
from reduced_models.least_squares.samples import grid_over
from reduced_models.least_squares.unknowns import Unknowns
from reduced_models.records.inputs import Grid, driving

FINE_STEPS = 64
"""Grid steps of a period: the phase error of a period is then 1e-9."""
_SAME_VALLEY = 2.0  # times the cost of the fit
_PARABOLA = 0.5  # share by which a cost may differ from the parabola about a fit, and belong to it
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
        Sum of the squared training residuals; infinite where the solution diverges.
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


class Searched(NamedTuple):
    """Where the starts led to on coarse grids: vectors (s, p) and costs (s,).

    ``reached`` is the time up to which each record was seen.
    """

    unknowns: Unknowns
    vector: JointVector
    bounds: Bounds
    theta: np.ndarray
    costs: np.ndarray
    reached: tuple[float, ...]


def fine_grids(law: Law, case: Case) -> list[Grid]:
    """The fine grid over each record.

    One of a driven law, whose steps end at the samples, is no finer than need be at first.
    """
    wanted = law.resolution * (COARSE_STEPS if driving(law.inputs) else FINE_STEPS)
    return [
        grid_over(data.record, law.inputs, data.guess.period, wanted, case.interpolation)
        for data in case.data
    ]


def refined(case: Case, found: Searched) -> Candidate:
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
    other = _collocated(joint, case, best, cost)
    collocation = "none"
    if other is best:
        collocation = "same"
    elif other is not None:
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
    """Of the training stretches; infinite where the solution diverges."""
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


def _collocated(
    joint: JointRecords, case: Case, theta: np.ndarray, cost: float
) -> np.ndarray | None:
    """The fit that starts from accelerations in the leading record; None where there are none.

    It is ``theta`` itself, a fit of that cost, where it starts in the same parabola.
    """
    unknowns, leader = joint.unknowns, case.leader
    if unknowns.map is None or unknowns.law.hidden or case.own:
        return None
    given = unknowns.map
    seen = leader.guess.seen_as(given.shift, given.scale)
    mapped = leader.look.mapped(given.shift, given.scale)
    values = np.array(unknowns.physical(theta[joint.vector.places[0]])[0])
    bounds = case.bounds_of(leader)
    found = matched_values(unknowns.law, seen, mapped, values, bounds)
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
    risen = _cost(joint, case, beside) - cost
    if _of_one_parabola(joint, case, theta, beside, risen):
        return theta
    if risen <= (_SAME_VALLEY - 1.0) * cost:
        return joint.sharpened(beside, case.samples, tolerance=_TELLING)
    reached = [FIRST_SWINGS * data.guess.quickest for data in case.data]
    return _along(joint, case, start, reached, _TELLING)


def _of_one_parabola(
    joint: JointRecords, case: Case, theta: np.ndarray, beside: np.ndarray, risen: float
) -> bool:
    """Whether cost and slope at a place are about those of the parabola about a fit.

    In another valley the cost may be so by chance; the slope, which falls towards that valley, is
    not so too.
    """
    normals = [grid.normal(size) for grid, size in zip(joint.grids, case.samples, strict=True)]
    normal, away = joint_normal(normals, joint.vector), beside - theta
    foreseen = float(away @ np.asarray(normal(theta[None])[2][0]) @ away)
    slope = float(away @ np.asarray(normal(beside[None])[1][0]))
    return all(abs(each - foreseen) <= _PARABOLA * foreseen for each in (risen, slope))
