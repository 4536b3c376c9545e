"""Calibrate parameters of a scene by fitting simulations to a laboratory record.

Equilibrium height, period and damping ratio of simulations (`reduced_models.calibration.simulations`) are
matched to the record by Gauss-Newton steps. The steps use the logarithms of these three features and of the
parameters, because the relation between these logarithms is almost linear. The derivatives are finite
differences for a change of a parameter by a tenth, with the same random packings of the bed before and after
the change. The derivatives are updated after each simulation of the search (Broyden 1965,
doi:10.1090/S0025-5718-1965-0198670-6).

The features also differ between beds with different initial packings, and the laboratory's bed is
one of many possible packings. The intervals therefore include both the record's noise and the scatter
over random packings.
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
from granular.run.plan import parse_time_step, scaled_time_step_setting
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError, RecordError, quote
from granular.studies.executors import given_executor_or_new_processes
from reduced_models.calibration.result import CalibratedValue, Calibration, RecordAndSimulatedFeature
from reduced_models.calibration.simulations import (
    DEFAULT_LAW,
    FeaturesOfRecord,
    SceneParameter,
    SceneSimulator,
    SimulatedPoint,
    measure_record_features,
    positive_scene_parameter,
)
from reduced_models.fitting.fit_data import list_of_records
from reduced_models.fitting.problem import check_fit_options
from reduced_models.fitting.uncertainty import OPEN, undetermined_directions
from reduced_models.laws.law import Law
from reduced_models.records.sources import DEFAULT_METHOD, make_directory

DIFFERENCE_STEP = 0.1
"""Step of the finite differences, in the logarithm of a parameter."""
MAXIMUM_STEP = 0.5
"""Maximum step of the search, in the logarithm of a parameter."""
MAXIMUM_MOVES = 8
# Slopes have errors of about a tenth. A last step of two standard errors that is not larger than the finite
# differences therefore has an error of a fraction of a standard error. Below the minimum step, rounding
# changes the beds more than the parameters do.
_SETTLED_ERRORS, _LINEAR_STEP, _MINIMUM_STEP = 2.0, 0.1, 1e-3


class GaussNewtonResult(NamedTuple):
    """Final state of a search."""

    centre: SimulatedPoint
    estimate: GaussNewtonStep
    scatter: Float[np.ndarray, "d d"]  # covariance of features over random starts
    simulations: int  # number of simulations, including all random starts
    settled: bool


def gauss_newton_search(simulator: SceneSimulator, wanted: FeaturesOfRecord) -> GaussNewtonResult:
    """Take Gauss-Newton steps on the logarithms of the features until the steps are below their errors."""
    # Slopes from differences with common random starts, updated by Broyden's formula (Broyden 1965,
    # doi:10.1090/S0025-5718-1965-0198670-6).
    start = np.log([parameter.value for parameter in simulator.parameters])
    strides = DIFFERENCE_STEP * np.eye(len(start))
    points = simulator.simulate_points([start, *(start + stride for stride in strides)])
    for point in points:
        if point.failure:
            raise InputError(f"{point.failure}; use other start values or a shorter dt")
    centre = points[0]
    slopes = np.stack([(point.logs - centre.logs) / DIFFERENCE_STEP for point in points[1:]], axis=2)
    radius = MAXIMUM_STEP
    for move in itertools.count():
        # Covariance (d, d) of the features over random starts, the mean over all positions.
        scatter = np.mean([np.atleast_2d(np.cov(point.logs, rowvar=False)) for point in points], axis=0)
        estimate = gauss_newton_step(centre, slopes, scatter, wanted)
        deviations = np.sqrt(np.diag(estimate.noise + estimate.scatter))
        short = np.clip(_SETTLED_ERRORS * deviations, _MINIMUM_STEP, _LINEAR_STEP)
        # Along a poorly determined direction, a short step of the logarithms may still change features by
        # much.
        settled = (np.abs(estimate.step) <= short).all() and (np.abs(estimate.moved) <= _SETTLED_ERRORS).all()
        if settled or move == MAXIMUM_MOVES:
            break
        step = estimate.step * min(1.0, radius / float(np.abs(estimate.step).max()))
        trial = simulator.simulate_points([centre.position + step])[0]
        if trial.failure:
            radius = 0.25 * float(np.abs(step).max())
            continue
        points.append(trial)
        if np.abs(step).max() >= 0.5 * DIFFERENCE_STEP:
            slope_error = trial.mean - centre.mean - slopes.mean(axis=0) @ step
            slopes = slopes + np.outer(slope_error, step) / (step @ step)
        better = _normalised_distance(trial, wanted, scatter) < _normalised_distance(centre, wanted, scatter)
        radius = min(MAXIMUM_STEP, 2.0 * radius) if better else 0.25 * float(np.abs(step).max())
        centre = trial if better else centre
    return GaussNewtonResult(centre, estimate, scatter, len(points) * len(simulator.seeds), bool(settled))


def _variance_of_feature_differences(
    wanted: FeaturesOfRecord, scatter: np.ndarray, starts: int
) -> np.ndarray:
    """Return the variance (d,) of the difference between the record's and the mean simulated features."""
    return np.asarray(wanted.errors**2 + (1.0 + 1.0 / starts) * np.diag(scatter))


def _normalised_distance(point: SimulatedPoint, wanted: FeaturesOfRecord, scatter: np.ndarray) -> float:
    deviation = np.log(wanted.values) - point.mean
    return float((deviation**2 / _variance_of_feature_differences(wanted, scatter, len(point.logs))).sum())


class GaussNewtonStep(NamedTuple):
    """A Gauss-Newton step, computed from linearised features at a point, and its uncertainty."""

    step: Float[np.ndarray, "p"]  # step along the determined directions
    noise: Float[np.ndarray, "p p"]  # covariance of this step due to the record's noise
    scatter: Float[np.ndarray, "p p"]  # covariance of this step due to random starts
    unknown: Float[np.ndarray, "p p"]  # covariance of the undetermined directions
    information: Float[np.ndarray, "p p"]
    gain: Float[np.ndarray, "p d"]  # derivative of the step by a feature
    moved: Float[np.ndarray, "d"]  # change of the features by the step, in standard deviations
    deviation: Float[np.ndarray, "d"]  # difference from the record after the step, in standard deviations


def gauss_newton_step(
    centre: SimulatedPoint,
    slopes: Float[np.ndarray, "starts d p"],
    scatter: Float[np.ndarray, "d d"],
    wanted: FeaturesOfRecord,
) -> GaussNewtonStep:
    """Compute a weighted Gauss-Newton step from the features at ``centre`` and their derivatives."""
    starts = len(slopes)
    mean = slopes.mean(axis=0)
    weight = 1.0 / np.maximum(_variance_of_feature_differences(wanted, scatter, starts), 1e-300)
    about = slopes - mean
    # The scatter of slopes over random starts would otherwise count as information.
    slope_scatter = np.einsum("sdk,d,sdl->kl", about, weight, about) / (starts * (starts - 1))
    information = (mean.T * weight) @ mean - slope_scatter
    strengths, directions = np.linalg.eigh(information)
    known = strengths > OPEN**-2
    inverse = np.where(known, 1.0 / np.where(known, strengths, 1.0), 0.0)
    gain = (directions * inverse) @ directions.T @ (mean.T * weight)
    residual = np.log(wanted.values) - centre.mean
    step = gain @ residual
    # Weights estimated from few random starts are not optimal; to first order, each feature in excess of the
    # determined directions increases the variance by this (C. R. Rao, Proc. 5th Berkeley Symp. 1 (1967) 355).
    chosen = 1.0 + max(0, len(residual) - int(known.sum())) / (starts - 1)
    free = np.where(known, 0.0, 1.0 / np.maximum(strengths, 1e-12))
    return GaussNewtonStep(
        step=step,
        noise=(gain * wanted.errors**2) @ gain.T,
        scatter=chosen * (1.0 + 1.0 / starts) * gain @ scatter @ gain.T,
        unknown=(directions * free) @ directions.T,
        information=information,
        gain=gain,
        moved=mean @ step * np.sqrt(weight),
        deviation=(residual - mean @ step) * np.sqrt(weight),
    )


SEED_COUNT = 4
"""Number of random packings of the bed for each set of parameters."""
MAXIMUM_SEED_COUNT = 10_000
_MINIMUM_DURATION = 0.99
_UNBOUNDED = math.log(1e6)  # half-width of a logarithmic interval above which it is unbounded
_MINIMUM_SHARE = 0.2  # minimum share of a parameter in a poorly determined direction, over the largest share
_WEAK_RATIO = 5.0  # minimum ratio of standard deviations along such a direction and the next one
# Number of standard deviations of the equilibrium height, the most precise feature of a record.
_HEIGHT_DEVIATIONS = 2.0
_FEATURE_DEVIATIONS = 4.0  # number of standard deviations above which a difference is not noise or scatter
# Relative error of the equilibrium height, which scatters by 0.03 % with dipoles, 0.8 % with rows of discs.
_MAXIMUM_HEIGHT_ERROR = 0.01


def calibrate(
    record: PistonRecord,
    scene: Scene,
    parameters: Sequence[str] = ("piston.mass", "effects.drag.coefficient"),
    *,
    seeds: int = SEED_COUNT,
    law: str | Law = DEFAULT_LAW,
    confidence: float = 0.95,
    dt: float | str = "auto",
    method: str = DEFAULT_METHOD,
    out: str | Path | None = None,
    checks: bool = True,
    executor: Executor | None = None,
    progress: bool = True,
) -> Calibration:
    """Calibrate parameters of a scene so that its simulations reproduce a record.

    Equilibrium height, period and damping ratio are matched by Gauss-Newton steps on logarithms, with
    derivatives updated by Broyden's formula (1965, doi:10.1090/S0025-5718-1965-0198670-6). Intervals use
    Student's t distribution, with the degrees of freedom of Welch (1947,
    doi:10.1093/biomet/34.1-2.28), since the scatter is estimated from few random packings.

    Parameters
    ----------
    record : PistonRecord or table (pandas, xarray)
        Measured motion that corresponds to the scene's stage ``output.record``, from the start of the
        stage: times [s] and heights [m], 20 or more samples of a piston that oscillates about
        equilibrium. If the record has a force [N], the mean force is matched as well.
    scene : Scene
        Scene that gives the start values of the calibrated parameters and all other values.
    parameters : sequence of str
        Dotted keys, each once, of quantities above 0, such as ``piston.mass``,
        ``effects.drag.coefficient`` and ``grains.remanence``. Scaling mass, remanence and drag together
        hardly changes a free oscillation; only a record with a force determines each of them.
    seeds : int
        Number of random packings of the bed for each set of parameters, from 2 to 10000; the seeds
        start at the scene's seed.
    law : str or Law
        Law that is fitted to the record and to the simulations; its equilibrium height, period and damping
        ratio are compared. For a driven record, give an equation that contains the name of the drive's
        column.
    confidence : float
        Confidence level of the intervals, a fraction between 0 and 1.
    dt : float or str
        Time step [s], or a rule such as ``"auto"``, as in `granular.simulate`.
    method : str
        Integration method, as in `granular.simulate`.
    out : str or Path, optional
        Directory that stores each finished simulation and the result; a repeated call continues from
        the stored simulations. By default nothing is written.
    checks : bool
        Whether to run one more simulation, with half the time step, to estimate the error due to the
        time step.
    executor : concurrent.futures.Executor, optional
        Executor of the simulations, as in `granular.sweep`; by default processes on this machine.
    progress : bool
        Whether to show a progress bar of each round of simulations on standard error.

    Returns
    -------
    Calibration
        Calibrated values in the units of their keys with intervals, and a comparison of the
        simulation with the record. An interval is (0, inf) if the record does not determine the value.

    Raises
    ------
    InputError
        If several records are given, the scene or law is unknown, an argument is out of its range, a
        key is not a quantity above 0 of the scene, the scene has no piston or no stage in which the
        piston moves freely, the fit to the record diverges from every start, or a simulation at the
        start values fails.
    RecordError
        If a table is not a record; if the record has no heights, has a prescribed stroke, has fewer
        than 20 samples, does not oscillate about an equilibrium height above 0, or lacks a column
        that the law needs; or if the residual of the law exceeds half of the rms displacement.
    StoreError
        If ``out`` cannot be created or written to.
    ExecutorLostError
        If the executor's processes are gone; ``out`` keeps the finished simulations.
    KeyboardInterrupt
        On Ctrl-C; ``out`` keeps the finished simulations.

    Warns
    -----
    UserWarning
        For each of the result's notes.
    """
    check_fit_options(confidence=confidence)
    record, *others = list_of_records(record)
    if others:
        raise InputError(f"calibrate needs one record, not {1 + len(others)}; give one record")
    if record.measured != "height":
        raise RecordError(
            f"calibrate needs heights, but the record contains only the {record.measured}; measure a position"
        )
    if isinstance(seeds, bool) or not isinstance(seeds, int) or not 2 <= seeds <= MAXIMUM_SEED_COUNT:
        raise InputError(
            f"seeds = {quote(seeds)} is outside the limits; give an integer from 2 (needed for the "
            f"scatter) to {MAXIMUM_SEED_COUNT}"
        )
    if not isinstance(parameters, Sequence):
        raise InputError(f"parameters = {quote(parameters)} is not a list; give a list of dotted keys")
    if not parameters or len(set(parameters)) != len(parameters):
        raise InputError(f"parameters = {list(parameters)}; give one or more keys, each only once")
    _check_scene_has_free_piston(scene)
    varied = tuple(positive_scene_parameter(scene, key) for key in parameters)
    resolve_method(method)
    parse_time_step(dt)
    force = record.force is not None
    wanted = measure_record_features(record, law, force=force)
    target = None if out is None else make_directory(out)
    first = scene.arrangement.seed
    with given_executor_or_new_processes(executor) as pool:
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
    simulator: SceneSimulator, record: PistonRecord, wanted: FeaturesOfRecord, confidence: float, checks: bool
) -> Calibration:
    """Find parameters for which simulations of a scene have the features of a record; return the result."""
    search_result = gauss_newton_search(simulator, wanted)
    shift, extra_simulations = (
        _time_step_error_and_simulation_count(simulator, search_result.centre) if checks else (None, 0)
    )
    position = search_result.centre.position + (search_result.estimate.step if search_result.settled else 0.0)
    values = simulator.scene_changes(position)
    simulated, scatter = map(math.exp, search_result.centre.mean), np.sqrt(np.diag(search_result.scatter))
    columns = (wanted.values.tolist(), simulated, wanted.errors.tolist(), scatter.tolist())
    return Calibration(
        parameters=tuple(
            _make_calibrated_value(item, k, values[item.key], search_result, shift, confidence)
            for k, item in enumerate(simulator.parameters)
        ),
        confidence=confidence,
        matches=tuple(map(RecordAndSimulatedFeature, wanted.names, *columns)),
        undetermined=undetermined_directions(
            [item.key for item in simulator.parameters], search_result.estimate.information
        ),
        scene=simulator.scene.replace(**values),
        record=record,
        motions=search_result.centre.records,
        simulations=search_result.simulations + extra_simulations,
        notes=(*wanted.notes, *_calibration_notes(simulator, wanted, search_result)),
    )


def _check_scene_has_free_piston(scene: Scene) -> None:
    if not isinstance(scene, Scene):
        raise InputError(f"scene = {quote(scene)} is not a Scene; give a Scene, for example from load_scene")
    if scene.piston is None:
        raise InputError(
            f"scene {quote(scene.name)} has no piston to calibrate; choose a scene with a piston"
        )
    if not any(stage.needs_piston_mass for stage in scene.protocol):
        raise InputError(
            f"scene {quote(scene.name)} has no stage in which the piston moves freely; add such a stage"
        )


def _time_step_error_and_simulation_count(
    simulator: SceneSimulator, centre: SimulatedPoint
) -> tuple[np.ndarray | None, int]:
    """Estimate errors (d,) of the features due to the time step; also return the number of simulations."""
    # Halving the step removes the fraction 1 - 2^-p of an error of order p.
    settings = {**simulator.settings, "dt": scaled_time_step_setting(simulator.settings["dt"], 0.5)}
    finer = dataclasses.replace(simulator, seeds=simulator.seeds[:1], settings=settings)
    point = finer.simulate_points([centre.position])[0]
    if point.failure:
        return None, 1
    growth = 2.0 ** resolve_method(simulator.settings["method"]).order
    return np.asarray(growth / (growth - 1.0) * (centre.logs[0] - point.logs[0])), 1


def _make_calibrated_value(
    item: SceneParameter,
    k: int,
    value: float,
    search_result: GaussNewtonResult,
    shift: np.ndarray | None,
    confidence: float,
) -> CalibratedValue:
    from scipy.stats import t as student

    estimate = search_result.estimate
    noise, scatter, unknown = (
        float(part[k, k]) for part in (estimate.noise, estimate.scatter, estimate.unknown)
    )
    variance = noise + scatter + unknown
    # Welch 1947, doi:10.1093/biomet/34.1-2.28, since the scatter is estimated from few starts only.
    starts = len(search_result.centre.logs)
    freedom = (starts - 1) * (variance / max(scatter + unknown, 1e-9 * variance, 1e-300)) ** 2
    half = float(student.ppf(0.5 + 0.5 * confidence, freedom)) * math.sqrt(variance)
    known = half < _UNBOUNDED
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


def _undetermined_combination_notes(keys: list[str], information: Float[np.ndarray, "p p"]) -> list[str]:
    """Return a note if the record determines a combination of parameters poorly but others well."""
    strengths, directions = np.linalg.eigh(information)
    powers = directions[:, 0] / np.abs(directions[:, 0]).max()
    mixed = [k for k in range(len(keys)) if abs(powers[k]) > _MINIMUM_SHARE]
    if len(mixed) < 2 or not 0.0 < strengths[0] < strengths[1] / _WEAK_RATIO**2:
        return []
    spread = 100.0 / math.sqrt(strengths[0])
    weighed = "piston.mass" in (keys[k] for k in mixed)
    remedy = "weigh the piston and set its mass" if weighed else "measure one of them and set it"
    changes = ", ".join(f"{keys[k]} by {powers[k] * spread:+.2g} %" for k in mixed)
    return [
        "some parameters can be changed together with hardly any effect on the record, by one standard "
        f"deviation: {changes}; {remedy}, or record the equilibrium height under two weighed masses"
    ]


def _calibration_notes(
    simulator: SceneSimulator, wanted: FeaturesOfRecord, search_result: GaussNewtonResult
) -> tuple[str, ...]:
    notes = []
    if not search_result.settled:
        notes.append(
            f"the search did not converge in {MAXIMUM_MOVES} steps, so the values are preliminary; "
            "calibrate again from these values"
        )
    notes += _undetermined_combination_notes(
        [item.key for item in simulator.parameters], search_result.estimate.information
    )
    for name, deviation in zip(wanted.names, search_result.estimate.deviation, strict=True):
        if abs(deviation) > (_HEIGHT_DEVIATIONS if name == "height" else _FEATURE_DEVIATIONS):
            notes.append(
                f"the calibrated values do not reproduce the record's {name.replace('_', ' ')}: "
                f"the simulated value differs by {abs(deviation):.2g} standard deviations, so the "
                "scene differs from the laboratory in other parameters or effects"
            )
    relative_height_error = math.exp(search_result.centre.mean[0]) / wanted.values[0] - 1.0
    if (
        abs(relative_height_error) > _MAXIMUM_HEIGHT_ERROR
        and abs(search_result.estimate.deviation[0]) <= _HEIGHT_DEVIATIONS
    ):
        notes.append(
            f"the simulated equilibrium height differs by {100.0 * relative_height_error:+.2g} % from the "
            "record's, so the values do not describe the damper: calibrate again from these values, "
            "calibrate fewer parameters, or use more random packings (--seeds)"
        )
    shortest = min(float(motion.time[-1]) for motion in search_result.centre.records)
    if shortest < _MINIMUM_DURATION * simulator.duration:
        notes.append(
            f"the simulations end after {shortest:.3g} s, but the record ends after "
            f"{simulator.duration:.3g} s; lengthen the stage"
        )
    return tuple(notes)
