"""Gauss-Newton steps on features of simulations, with slopes from common random starts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.errors import InputError
from reduced_models.calibration.simulations import RecordFeatures, SceneSimulator, SimulatedPoint
from reduced_models.fitting.uncertainty import OPEN

if TYPE_CHECKING:
    from jaxtyping import Float

STRIDE = 0.1
"""Step of the differences, in logarithms."""
RADIUS = 0.5
"""Longest step of a logarithm."""
MOST_MOVES = 8
_SETTLED, _LINEAR, _LEAST_STEP = 2.0, 0.1, 1e-3
# Slopes err by about a tenth, so a last step of two standard errors, if it is no longer than the
# differences, errs by a fraction of one; shorter ones move the beds rather than the values.


class GaussNewtonResult(NamedTuple):
    """The end of a search."""

    centre: SimulatedPoint
    estimate: LinearEstimate
    scatter: Float[np.ndarray, "d d"]  # covariance of features over random starts
    simulations: int  # of scenes, random starts counted
    settled: bool


def gauss_newton_search(simulator: SceneSimulator, wanted: RecordFeatures) -> GaussNewtonResult:
    """Take Gauss-Newton steps on the features' logarithms until they are smaller than their errors."""
    # Slopes by differences with common random starts, updated by Broyden's formula (Broyden 1965,
    # doi:10.1090/S0025-5718-1965-0198670-6).
    start = np.log([parameter.value for parameter in simulator.parameters])
    strides = STRIDE * np.eye(len(start))
    points = simulator.simulate_points([start, *(start + stride for stride in strides)])
    for point in points:
        if point.failure:
            raise InputError(f"{point.failure}; start from other values or a shorter dt")
    centre = points[0]
    slopes = np.stack([(point.logs - centre.logs) / STRIDE for point in points[1:]], axis=2)
    radius = RADIUS
    for move in itertools.count():
        scatter = _scatter_covariance(points)
        estimate = linear_estimate(centre, slopes, scatter, wanted)
        deviations = np.sqrt(np.diag(estimate.noise + estimate.scatter))
        short = np.clip(_SETTLED * deviations, _LEAST_STEP, _LINEAR)
        # Along a direction that is hardly known, a short step of the logarithms may move features by much.
        settled = (np.abs(estimate.step) <= short).all() and (np.abs(estimate.moved) <= _SETTLED).all()
        if settled or move == MOST_MOVES:
            break
        step = estimate.step * min(1.0, radius / float(np.abs(estimate.step).max()))
        trial = simulator.simulate_points([centre.position + step])[0]
        if trial.failure:
            radius = 0.25 * float(np.abs(step).max())
            continue
        points.append(trial)
        if np.abs(step).max() >= 0.5 * STRIDE:
            lacking = trial.mean - centre.mean - slopes.mean(axis=0) @ step
            slopes = slopes + np.outer(lacking, step) / (step @ step)
        better = _normalised_distance(trial, wanted, scatter) < _normalised_distance(centre, wanted, scatter)
        radius = min(RADIUS, 2.0 * radius) if better else 0.25 * float(np.abs(step).max())
        centre = trial if better else centre
    return GaussNewtonResult(centre, estimate, scatter, len(points) * len(simulator.seeds), bool(settled))


def _scatter_covariance(points: Sequence[SimulatedPoint]) -> np.ndarray:
    """Covariance (d, d) of the features over random starts, the mean over all positions."""
    parts = [np.atleast_2d(np.cov(point.logs, rowvar=False)) for point in points]
    return np.asarray(np.mean(parts, axis=0))


def _variance_of_difference(wanted: RecordFeatures, scatter: np.ndarray, starts: int) -> np.ndarray:
    """Variance (d,) of the features of the record about the mean of the simulated ones."""
    return np.asarray(wanted.errors**2 + (1.0 + 1.0 / starts) * np.diag(scatter))


def _normalised_distance(point: SimulatedPoint, wanted: RecordFeatures, scatter: np.ndarray) -> float:
    away = np.log(wanted.values) - point.mean
    return float((away**2 / _variance_of_difference(wanted, scatter, len(point.logs))).sum())


class LinearEstimate(NamedTuple):
    """A step of linearised features at a point, and its uncertainty."""

    step: Float[np.ndarray, "p"]  # along the directions that are known
    noise: Float[np.ndarray, "p p"]  # covariance there by the record's noise
    scatter: Float[np.ndarray, "p p"]  # and by random starts
    unknown: Float[np.ndarray, "p p"]  # covariance of the open directions
    information: Float[np.ndarray, "p p"]
    gain: Float[np.ndarray, "p d"]  # of the step by a change of a feature
    moved: Float[np.ndarray, "d"]  # change of the features by the step, in standard deviations
    away: Float[np.ndarray, "d"]  # and their difference to the record after it


def linear_estimate(
    centre: SimulatedPoint,
    slopes: Float[np.ndarray, "starts d p"],
    scatter: Float[np.ndarray, "d d"],
    wanted: RecordFeatures,
) -> LinearEstimate:
    """Take a weighted Gauss-Newton step on linearised features."""
    starts = len(slopes)
    mean = slopes.mean(axis=0)
    weight = 1.0 / np.maximum(_variance_of_difference(wanted, scatter, starts), 1e-300)
    about = slopes - mean
    # Slopes that differ from start to start would else pass for information.
    doubt = np.einsum("sdk,d,sdl->kl", about, weight, about) / (starts * (starts - 1))
    information = (mean.T * weight) @ mean - doubt
    strengths, directions = np.linalg.eigh(information)
    known = strengths > OPEN**-2
    inverse = np.where(known, 1.0 / np.where(known, strengths, 1.0), 0.0)
    gain = (directions * inverse) @ directions.T @ (mean.T * weight)
    residual = np.log(wanted.values) - centre.mean
    step = gain @ residual
    # Weights that few random starts tell are not the best ones; to first order, each feature beyond
    # the known directions costs that much (C. R. Rao, Proc. 5th Berkeley Symp. 1 (1967) 355).
    chosen = 1.0 + max(0, len(residual) - int(known.sum())) / (starts - 1)
    free = np.where(known, 0.0, 1.0 / np.maximum(strengths, 1e-12))
    return LinearEstimate(
        step=step,
        noise=(gain * wanted.errors**2) @ gain.T,
        scatter=chosen * (1.0 + 1.0 / starts) * gain @ scatter @ gain.T,
        unknown=(directions * free) @ directions.T,
        information=information,
        gain=gain,
        moved=mean @ step * np.sqrt(weight),
        away=(residual - mean @ step) * np.sqrt(weight),
    )
