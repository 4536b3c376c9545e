"""`calibrate`: numbers of a scene from a lab record, by fitting simulations to it.

Level of rest, period and damping ratio of simulations (`reduced_models.calibration.simulations`)
are brought to those of the record by Gauss-Newton steps on logarithms, in which they are nearly
linear. The slopes are differences over tenths, from the same random starts of the bed on both
sides, and follow the simulations that are made in the search (Broyden 1965,
doi:10.1090/S0025-5718-1965-0198670-6).

Two beds that differ by their random start alone differ in these figures as well. A lab's bed is
one more such bed: the intervals hold the record's noise and the scatter over random starts.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.methods import resolve_method
from granular.records.record import PistonRecord
from granular.run.plan import multiply_time_step, parse_time_step
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError, RecordError, quote
from granular.studies.executors import case_executor
from reduced_models.calibration.result import CalibratedValue, Calibration, FeatureMatch
from reduced_models.calibration.simulations import (
    LAW,
    RecordFeatures,
    SceneParameter,
    SceneSimulator,
    SimulatedPoint,
    record_features,
    scene_parameter,
)
from reduced_models.fitting.fit_data import list_of_records
from reduced_models.fitting.problem import check_fit_options
from reduced_models.fitting.uncertainty import OPEN, undetermined_directions
from reduced_models.laws.law import Law
from reduced_models.records.sources import METHOD, make_directory

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
        # Covariance (d, d) of the features over random starts, the mean over all positions.
        scatter = np.mean([np.atleast_2d(np.cov(point.logs, rowvar=False)) for point in points], axis=0)
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


SEEDS = 4
"""Random starts of the bed at every position."""
MAX_SEEDS = 10_000
_SHORT = 0.99
_UNKNOWN = math.log(1e6)  # half-width of an interval on the logarithm that says nothing any more
_SMALL_POWER = 0.2  # least share of a parameter in a direction that is hardly known, over the largest
_WEAK = 5.0  # least ratio of standard deviations, along such a direction and the next one
_OFF_REST = 2.0  # standard deviations of the height at rest, which a record has best
_STRANGE = 4.0  # standard deviations of a feature that noise and scatter do not explain
_OFF_HEIGHT = 0.01  # of the height at rest; starts scatter by 0.03 % with dipoles, 0.8 % with rows of discs


def calibrate(
    record: PistonRecord,
    scene: Scene,
    parameters: Sequence[str] = ("piston.mass", "effects.drag.coefficient"),
    *,
    seeds: int = SEEDS,
    law: str | Law = LAW,
    confidence: float = 0.95,
    dt: float | str = "auto",
    method: str = METHOD,
    out: str | Path | None = None,
    checks: bool = True,
    executor: Executor | None = None,
    progress: bool = True,
) -> Calibration:
    """Calibrate numbers of a scene, so that its simulations move as a record does.

    Level of rest, period and damping ratio are matched by Gauss-Newton steps on logarithms, with
    slopes updated by Broyden's formula (1965, doi:10.1090/S0025-5718-1965-0198670-6). Intervals are
    those of Student's t distribution, with degrees of freedom by Welch (1947,
    doi:10.1093/biomet/34.1-2.28), as the scatter is known from few random starts.

    Parameters
    ----------
    record : PistonRecord or table of one (pandas, xarray)
        The motion of the stage that the scene names as ``output.record``, from its start on: times
        [s] and heights [m], at least 20 samples of a piston that swings about rest. Where it has a
        force [N], the mean force counts as well.
    scene : Scene
        Scene that says everything else, and where to start.
    parameters : sequence of str
        Dotted keys, each once, of quantities above 0, such as ``piston.mass``,
        ``effects.drag.coefficient`` and ``grains.remanence``. Mass and remanence (and drag) scale
        together without a free swing noticing much: the force tells them apart.
    seeds : int
        Random starts of the bed at every position, from the scene's own on; 2 to 10000.
    law : str or Law
        Law that is fitted to record and simulations, and whose level of rest, period and damping
        ratio are compared; where the record is driven, an equation with the drive's column.
    confidence : float
        Confidence level of the intervals, a fraction between 0 and 1.
    dt : float or str
        Time step [s], or a rule such as ``"auto"``, as in `granular.simulate`.
    method : str
        Integration method, as in `granular.simulate`.
    out : str or Path, optional
        Directory that keeps every simulation as soon as it is done, and the result; called again,
        the calibration goes on from there. Nothing is written if not given.
    checks : bool
        True for one more simulation, with half the time step, that tells what the step does.
    executor : concurrent.futures.Executor, optional
        Where the simulations run, as in `granular.sweep`; processes on this machine if not given.
    progress : bool
        Show a progress bar of each round of simulations on standard error.

    Returns
    -------
    Calibration
        Calibrated values in the units of their keys with intervals, and how the simulation compares
        with the record. An interval is (0, inf) where the record does not tell the value.

    Raises
    ------
    InputError
        If it is not one record, there is no such scene or law, an argument is out of its range, a
        key is no quantity above 0 that the scene holds, the scene has no piston or no stage in
        which it moves freely, no start of the fit to the record stays finite, or a simulation at
        the start fails.
    RecordError
        If a table is no record, or the record holds no heights or those of a prescribed stroke, has
        fewer than 20 samples, does not swing about a level of rest that is above 0, or lacks a
        column that the law needs; or if the law leaves more than half of the swing unexplained.
    StoreError
        If ``out`` cannot be made or written to.
    ExecutorLostError
        If the executor's processes are gone; ``out`` keeps what was done.
    KeyboardInterrupt
        On Ctrl-C; ``out`` keeps what was done.

    Warns
    -----
    UserWarning
        For each of the result's notes.
    """
    check_fit_options(confidence=confidence)
    record, *others = list_of_records(record)
    if others:
        raise InputError(f"calibrate is of one record, not of {1 + len(others)}; give one")
    if record.measured != "height":
        raise RecordError(
            f"calibrate needs heights, and this record holds the {record.measured} only; record a position"
        )
    if isinstance(seeds, bool) or not isinstance(seeds, int) or not 2 <= seeds <= MAX_SEEDS:
        raise InputError(
            f"seeds = {quote(seeds)}; give an integer from 2 on, to see their scatter, "
            f"and at most {MAX_SEEDS}"
        )
    if not isinstance(parameters, Sequence):
        raise InputError(f"parameters = {quote(parameters)}; give dotted keys in a list")
    if not parameters or len(set(parameters)) != len(parameters):
        raise InputError(f"parameters = {list(parameters)}; give at least one, each once")
    _check_scene(scene)
    varied = tuple(scene_parameter(scene, key) for key in parameters)
    resolve_method(method)
    parse_time_step(dt)
    force = record.force is not None
    wanted = record_features(record, law, force=force)
    target = None if out is None else make_directory(out)
    first = scene.arrangement.seed
    with case_executor(executor) as pool:
        simulator = SceneSimulator(
            scene=scene,
            parameters=varied,
            seeds=tuple(range(first, first + seeds)),
            law=law,
            duration=float(record.time[-1] - record.time[0]),
            force=force,
            settings={
                "dt": dt,
                "method": method,
                "out": None if target is None else target / "simulations",
                "executor": pool,
                "progress": progress,
            },
        )
        result = run_calibration(simulator, record, wanted, confidence, checks)
    for note in result.notes:
        warnings.warn(note, stacklevel=2)
    if target is not None:
        result.save(target)
    return result


def run_calibration(
    simulator: SceneSimulator, record: PistonRecord, wanted: RecordFeatures, confidence: float, checks: bool
) -> Calibration:
    """Numbers for which a scene's simulations have the wanted features of a record."""
    ended = gauss_newton_search(simulator, wanted)
    shift, more = _time_step_error(simulator, ended.centre) if checks else (None, 0)
    position = ended.centre.position + (ended.estimate.step if ended.settled else 0.0)
    values = simulator.scene_changes(position)
    simulated, scatter = map(math.exp, ended.centre.mean), np.sqrt(np.diag(ended.scatter))
    columns = (wanted.values.tolist(), simulated, wanted.errors.tolist(), scatter.tolist())
    return Calibration(
        parameters=tuple(
            _calibrated_value(item, k, values[item.key], ended, shift, confidence)
            for k, item in enumerate(simulator.parameters)
        ),
        confidence=confidence,
        matches=tuple(map(FeatureMatch, wanted.names, *columns)),
        undetermined=undetermined_directions(
            [item.key for item in simulator.parameters], ended.estimate.information
        ),
        scene=simulator.scene.replace(**values),
        record=record,
        motions=ended.centre.records,
        simulations=ended.simulations + more,
        notes=(*wanted.notes, *_calibration_notes(simulator, wanted, ended)),
    )


def _check_scene(scene: Scene) -> None:
    if not isinstance(scene, Scene):
        raise InputError(f"scene = {quote(scene)}; give a Scene, as load_scene makes it")
    if scene.piston is None:
        raise InputError(f"scene {quote(scene.name)} has no piston, so there is nothing to calibrate")
    if not any(stage.needs_piston_mass for stage in scene.protocol):
        raise InputError(f"scene {quote(scene.name)} has no stage in which the piston moves freely; add one")


def _time_step_error(simulator: SceneSimulator, centre: SimulatedPoint) -> tuple[np.ndarray | None, int]:
    """Estimated error of the features (d,) by the time step, and how many simulations it took."""
    # Half the step changes 1 - 2^-p of an error of order p.
    settings = {**simulator.settings, "dt": multiply_time_step(simulator.settings["dt"], 0.5)}
    finer = dataclasses.replace(simulator, seeds=simulator.seeds[:1], settings=settings)
    point = finer.simulate_points([centre.position])[0]
    if point.failure:
        return None, 1
    growth = 2.0 ** resolve_method(simulator.settings["method"]).order
    return np.asarray(growth / (growth - 1.0) * (centre.logs[0] - point.logs[0])), 1


def _calibrated_value(
    item: SceneParameter,
    k: int,
    value: float,
    ended: GaussNewtonResult,
    shift: np.ndarray | None,
    confidence: float,
) -> CalibratedValue:
    from scipy.stats import t as student

    estimate = ended.estimate
    noise, scatter, unknown = (
        float(part[k, k]) for part in (estimate.noise, estimate.scatter, estimate.unknown)
    )
    variance = noise + scatter + unknown
    # Welch 1947, doi:10.1093/biomet/34.1-2.28: the scatter is known from few starts only.
    starts = len(ended.centre.logs)
    freedom = (starts - 1) * (variance / max(scatter + unknown, 1e-9 * variance, 1e-300)) ** 2
    half = float(student.ppf(0.5 + 0.5 * confidence, freedom)) * math.sqrt(variance)
    known = half < _UNKNOWN
    return CalibratedValue(
        key=item.key,
        unit=item.unit,
        value=value,
        interval=(value * math.exp(-half), value * math.exp(half)) if known else (0.0, math.inf),
        start=item.value,
        noise=math.sqrt(noise),
        scatter=math.sqrt(scatter),
        step=None if shift is None else abs(float(estimate.gain[k] @ shift)),
    )


def _weak_direction_notes(keys: list[str], information: Float[np.ndarray, "p p"]) -> list[str]:
    """Name parameters that the record knows well together, and badly apart."""
    strengths, directions = np.linalg.eigh(information)
    powers = directions[:, 0] / np.abs(directions[:, 0]).max()
    mixed = [k for k in range(len(keys)) if abs(powers[k]) > _SMALL_POWER]
    if len(mixed) < 2 or not 0.0 < strengths[0] < strengths[1] / _WEAK**2:
        return []
    spread = 100.0 / math.sqrt(strengths[0])
    weighed = "piston.mass" in (keys[k] for k in mixed)
    remedy = "weigh the piston and set its mass" if weighed else "measure one of them and set it"
    changes = ", ".join(f"{keys[k]} by {powers[k] * spread:+.2g} %" for k in mixed)
    return [
        f"the record hardly tells parameters apart that change together, {changes} (one standard "
        f"deviation); {remedy}, or record the height at rest under two weighed masses"
    ]


def _calibration_notes(
    simulator: SceneSimulator, wanted: RecordFeatures, ended: GaussNewtonResult
) -> tuple[str, ...]:
    notes = []
    if not ended.settled:
        notes.append(
            f"the search did not settle in {MOST_MOVES} moves, so read the values as a step there; "
            "calibrate again from them"
        )
    notes += _weak_direction_notes([item.key for item in simulator.parameters], ended.estimate.information)
    for name, away in zip(wanted.names, ended.estimate.away, strict=True):
        if abs(away) > (_OFF_REST if name == "height" else _STRANGE):
            notes.append(
                f"no values give the record's {name.replace('_', ' ')}: it stays "
                f"{abs(away):.2g} standard deviations away, so something else in the scene is not "
                "as in the laboratory"
            )
    off = math.exp(ended.centre.mean[0]) / wanted.values[0] - 1.0
    if abs(off) > _OFF_HEIGHT and abs(ended.estimate.away[0]) <= _OFF_REST:
        notes.append(
            f"the simulations rest {100.0 * off:+.2g} % off the record's height, so the values are not its "
            "damper's: calibrate again from them, fit fewer numbers, or take more random starts (--seeds)"
        )
    shortest = min(float(motion.time[-1]) for motion in ended.centre.records)
    if shortest < _SHORT * simulator.duration:
        notes.append(
            f"the simulations end after {shortest:.3g} s, and the record after "
            f"{simulator.duration:.3g} s; lengthen the stage"
        )
    return tuple(notes)
