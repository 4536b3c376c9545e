"""Turn a fit into a model: parameters with intervals, quality of the fit, and notes on weak points."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, format_factor, quote
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import SearchResult, input_delay_remarks
from reduced_models.fitting.residual_diagnostics import (
    NEGLIGIBLE_RESIDUAL,
    autocorrelation_time,
    count_release_transient_samples,
    diagnose_residuals,
    remarks_on_parameters_held_at_zero,
)
from reduced_models.fitting.residuals import DIVERGED_RESIDUAL, remove_random_walk, rms
from reduced_models.fitting.uncertainty import (
    FitStatistics,
    Interval,
    intervals_oscillation_and_directions,
    joint_covariance_and_independent_count,
    marginal_information,
    physical_covariance,
    rest_height_period_and_damping,
    search_vector_shifts_by_calibration_errors,
    widen_to_linear_intervals,
)
from reduced_models.laws.linearization import NoOscillationReason
from reduced_models.models.at_rest import AtRest, HarmonicCycle
from reduced_models.models.model import ReducedModel
from reduced_models.models.observed import measure_stroke_cycles
from reduced_models.models.quantities import Quality
from reduced_models.records.derivatives import NORMAL_MEDIAN, noise_standard_deviation, sensor_rounding_step
from reduced_models.records.envelope import (
    amplitude_remarks,
    describe_extreme_mismatch,
    envelope_of_extremes,
    find_extremes,
)
from reduced_models.records.free_motion import PredictionErrorEstimate, prediction_error_on_cycles
from reduced_models.records.release import release_sample_index
from reduced_models.records.second_mode import find_second_mode
from reduced_models.records.sensor import Sensor
from reduced_models.records.sensor_filter import find_sensor_filter
from reduced_models.records.sources import describe_record

MINIMUM_AGREEING_FRACTION = 0.25
"""A note warns if less than this fraction of the random starts leads to the best fit."""
# Residuals below this fraction of the rms displacement are rounding and solver error: ten times
# `SOLVER_LIMIT`.
ROUNDING_RESIDUAL = 1e-5
OSCILLATING_FRACTION = 0.5
"""Residuals count as oscillating if more than this fraction of their power is near the motion's frequency."""
DRIFT_POWER_RATIO = 4.0
"""Residuals count as drifting if their low-frequency power exceeds this multiple of white noise's power."""
NOISY_FRACTION = 0.3
"""A note warns if the noise exceeds this fraction of the rms displacement."""
SUSPICIOUS_ACCELERATION = 500.0
"""A note warns if the acceleration exceeds this value [m/s^2], fifty times gravity."""
REPORTED_LAG_FRACTION = 0.1
"""A lag of the solution behind the record is reported above this fraction of the sampling interval."""
_DRIFT_NOTE = (
    "the record's zero drifts by {size:.2g} {unit} in total, as a random walk in addition to the noise; "
    "the fit includes the drift, and the intervals allow for it; FitOptions(drift=False) (fit --no-drift on "
    "the command line) omits the drift"
)
_DRIFT_REMEDY = "fit with FitOptions(drift=True) (fit --drift on the command line)"
_ROUNDING_QUANTILE, _ROUNDING_FRACTION = 0.99, 0.6
"""Residuals count as pure rounding errors if the 0.99 quantile of their magnitude is below 0.6 of the
sensor's rounding step. Rounding errors themselves are at most half a step."""
NOTED_NOISE_RATIO, NOTED_FRACTION = 3.0, 0.05
"""A note warns if the residual exceeds both 3 times the noise and 5 % of the rms displacement."""


def models_from_fit(result: SearchResult, *, drift_was_found: bool = False) -> tuple[ReducedModel, ...]:
    """Return the reduced model of each record of a fit, with intervals, quality and notes."""
    problem, theta = result.problem, result.theta
    normal = problem.normal_matrix(theta)
    if not np.isfinite(normal).all():
        raise InputError(
            f"the fit of {quote(problem.law.name)} changes so steeply with its parameters "
            "that the intervals cannot be computed; try another law, or check the units of height and time"
        )
    residuals = tuple(problem.residuals(theta))
    white = tuple(
        remove_random_walk(series, data.gain) for series, data in zip(residuals, problem.data, strict=True)
    )
    covariance, independent = joint_covariance_and_independent_count(problem, theta)
    shifts = search_vector_shifts_by_calibration_errors(problem, theta)
    covariance = covariance + shifts.T @ shifts
    free = ~problem.held_entry_mask
    profiled = None
    models = dict[int, ReducedModel]()
    motions = [
        data.record
        if data.unknowns.compares_heights
        else PistonRecord(data.record.time, data.fitted_heights(theta[data.joint_vector_indices]))
        for data in problem.data
    ]
    for k, data in enumerate(problem.data):
        if data.number in models:  # this is a further observation of the same record
            without_drift = remove_random_walk(residuals[k], data.gain)
            model, quality = models[data.number], _assess_quality(result, k, residuals[k], without_drift)
            qualities = {**model.qualities, data.unknowns.observation: quality}
            models[data.number] = dataclasses.replace(model, qualities=qualities)
            continue
        here, height = data.joint_vector_indices, motions[k].height
        known = FitStatistics(
            marginal_information(normal, here, free),
            covariance[np.ix_(here, here)],
            white,
            int(free.sum()),
            free[here],
            independent,
        )
        quantile = known.student_quantile(problem.confidence)
        intervals, at_rest, undetermined = intervals_oscillation_and_directions(
            problem.unknowns,
            theta[here],
            known,
            quantile,
            (float(height.min()), float(height.max())),
            shifts[:, here],
        )
        if problem.intervals == "profile":
            from reduced_models.fitting.profile_likelihood import profile_intervals

            profiled = profiled or profile_intervals(problem, theta, covariance, quantile)
            intervals = widen_to_linear_intervals(intervals, undetermined, profiled[k])
        names, matrix = physical_covariance(problem.unknowns, theta[here], known.covariance)
        model = _make_model_of_record(result, k, intervals, at_rest, motions, residuals[k])
        drift = _DRIFT_NOTE.format(size=model.quality.zero_drift, unit=model.coordinate_unit)
        notes = (*model.notes, drift) if drift_was_found else model.notes
        models[data.number] = dataclasses.replace(
            model,
            undetermined=undetermined,
            covariance_names=names,
            covariance=matrix,
            notes=notes,
            quantile=quantile,
        )
    return tuple(models.values())


def _make_model_of_record(
    result: SearchResult,
    k: int,
    intervals: Mapping[str, Interval],
    at_rest: AtRest | NoOscillationReason,
    motions: Sequence[PistonRecord],
    residuals: np.ndarray,
) -> ReducedModel:
    problem, data = result.problem, result.problem.data[k]
    unknowns, record = data.unknowns, data.record
    theta = result.theta[data.joint_vector_indices]
    values, height, velocity, hidden = unknowns.physical_values(theta)
    without_drift = remove_random_walk(residuals, data.gain)
    quality = _assess_quality(result, k, residuals, without_drift)
    parameters = dict(zip(unknowns.law.parameters, map(float, values), strict=True))
    rest = None if isinstance(at_rest, NoOscillationReason) else at_rest
    remarks: tuple[str, ...] = ()
    if unknowns.law.inputs:
        if quality.has_structured_residuals:
            remarks = input_delay_remarks(problem, result.theta, k)
    else:
        fitted = record.height + residuals * unknowns.residual_unit
        rest, remarks = _add_damping_from_peaks(rest, motions[k], fitted)
        remarks = (*_mode_and_filter_texts(unknowns, record, quality), *remarks)
    known = {name: value for name, value in parameters.items() if name not in problem.unidentified}
    ends = (float(record.height.min()), float(record.height.max()))
    observed = {unknowns.observation: ends} if unknowns.observation else {}
    return ReducedModel(
        law=unknowns.law,
        parameters=known,
        intervals={name: pair for name, pair in intervals.items() if name not in problem.unidentified},
        confidence=problem.confidence,
        initial=(float(height), float(velocity)),
        at_rest=None if rest is None else dataclasses.replace(rest, coordinate_unit=record.coordinate_unit),
        no_swing=at_rest.reason if isinstance(at_rest, NoOscillationReason) else "",
        quality=quality,
        domain=_ranges_of_motion(motions) | observed,
        notes=(
            *_model_notes(
                quality,
                _robust_residual_size(data, without_drift),
                record,
                _release_transient_text(data, without_drift),
            ),
            *problem.notes,
            *remarks,
            *remarks_on_parameters_held_at_zero(
                unknowns.law,
                np.flatnonzero(~problem.held_entry_mask[data.joint_vector_indices]),
                *data.weighted_residuals_and_derivatives(theta),
            ),
            *_notes_on_parameters_at_bounds(parameters, problem.bounds),
            *_suspicious_unit_notes(unknowns, record.coordinate_unit),
        ),
        provenance=_provenance_texts(
            record, problem, None if isinstance(at_rest, NoOscillationReason) else at_rest.period
        ),
        hidden={
            name: float(state)
            for name, state in zip(unknowns.law.hidden, hidden, strict=True)
            if state != 0.0
        },
        input_interpolation=data.interpolation,
        coordinate_unit=record.coordinate_unit,
        sensor=_fitted_sensor(unknowns, theta),
        untold=problem.unidentified,
        conventions={name: value for name, value in parameters.items() if name not in known},
        observation=unknowns.observation,
        cycles=_measured_cycles_of_strokes(result, motions),
    )


def _measured_cycles_of_strokes(
    result: SearchResult, motions: Sequence[PistonRecord]
) -> tuple[HarmonicCycle, ...]:
    """Return the cycles of the measured force along prescribed strokes; empty for a free or driven motion."""
    sensor, law = result.problem.unknowns.sensor, result.problem.law
    if not law.prescribed or sensor is None or law.observations != ("force",):
        return ()
    gain, offset = sensor.nominal_gain, sensor.nominal_offset
    return measure_stroke_cycles(
        motions, [(data.record.height - offset) / gain for data in result.problem.data]
    )


def _fitted_sensor(unknowns: SearchUnknowns, theta: np.ndarray) -> Sensor | None:
    """Return the sensor with the fitted gain and offset, or None if no sensor was used."""
    if unknowns.sensor is None:
        return None
    gain, offset = unknowns.gain_and_offset(theta)
    return dataclasses.replace(unknowns.sensor, gain=gain, offset=offset)


def _add_damping_from_peaks(
    rest: AtRest | None, record: PistonRecord, fitted: np.ndarray
) -> tuple[AtRest | None, tuple[str, ...]]:
    """Add the damping ratio of the record's peaks to the small oscillation; also return remarks on the decay.

    The peaks' damping ratio is added only if it contradicts the fitted one and the fitted motion (n,) has the
    same peaks as the record. If the peaks differ, those of the record are noise.
    """
    try:
        extremes = find_extremes(record)
        cycles = envelope_of_extremes(extremes)
        motion = find_extremes(PistonRecord(record.time, fitted), exact=True)
    except GranularError:  # too few extremes
        return rest, ()
    peaks = cycles.peak_damping
    if (
        rest is not None
        and peaks.contradicts(rest.damping_ratio)
        and not describe_extreme_mismatch(extremes, motion)
    ):
        rest = dataclasses.replace(rest, peaks=peaks)
    low, high = (0.0, 0.0) if rest is None or rest.peaks else rest.intervals["damping_ratio"]
    return rest, amplitude_remarks(cycles, low > 0.0 or high < 0.0)


def _mode_and_filter_texts(
    unknowns: SearchUnknowns, record: PistonRecord, quality: Quality
) -> tuple[str, ...]:
    """Describe a second mode, or else a sensor's filter, found in the residuals of a one-coordinate law."""
    of_height = unknowns.sensor is None and not unknowns.observation and not unknowns.law.prescribed
    if not of_height or unknowns.law.other_coordinates or not quality.has_structured_residuals:
        return ()
    mode = find_second_mode(record.time, record.height)
    if mode is not None and mode.is_in_residual_of_law(quality.residual):
        return (mode.text,)
    sensor_filter = find_sensor_filter(record.time, record.height, quality.residual)
    return () if sensor_filter is None else (sensor_filter.text(quality.residual),)


def _ranges_of_motion(records: Sequence[PistonRecord]) -> dict[str, tuple[float, float]]:
    """Return the ranges of height [m] and velocity [m/s] over all records of a fit."""
    heights = np.concatenate([record.height for record in records])
    speeds = np.concatenate([np.gradient(record.height, record.time) for record in records])
    return {
        "height": (float(heights.min()), float(heights.max())),
        "velocity": (float(speeds.min()), float(speeds.max())),
    }


def _provenance_texts(record: PistonRecord, problem: FitProblem, period: float | None) -> dict[str, str]:
    """Describe the data and settings of a fit; the same fit always gives the same text."""
    digest = hashlib.sha256(record.time.tobytes() + record.height.tobytes()).hexdigest()
    pairs = problem.bounds.items()
    bound_texts = [f"{low:g} <= {name} <= {high:g}" for name, (low, high) in pairs if low < high]
    bound_texts += [f"{name} = {low:g} given" for name, (low, high) in pairs if low == high]
    bounds = ", ".join(bound_texts)
    return {
        "data": f"{len(record)} samples over {record.time[-1] - record.time[0]:.6g} s, sha256 {digest[:16]}",
        "record": "\n".join(describe_record(record, period)),
        "records": str(1 + problem.data[-1].number),
        "fit": f"{problem.starts} starts, intervals {problem.intervals}" + (f", {bounds}" * bool(bounds)),
    }


def _notes_on_parameters_at_bounds(
    parameters: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    return tuple(
        f"{name} = {parameters[name]:.5g} lies at its bound; widen the bounds or regard the value as given"
        for name, pair in bounds.items()
        if pair[0] < pair[1] and any(math.isclose(parameters[name], edge) for edge in pair)
    )


def _suspicious_unit_notes(unknowns: SearchUnknowns, coordinate_unit: str) -> tuple[str, ...]:
    acceleration = unknowns.speed**2 / unknowns.amplitude
    if coordinate_unit == "rad" or acceleration < SUSPICIOUS_ACCELERATION:
        return ()
    return (
        f"the acceleration of the motion is {acceleration:.2g} m/s^2; check the units of height and time, "
        "m and s by default",
    )


def _assess_quality(
    result: SearchResult, k: int, residuals: np.ndarray, without_drift: np.ndarray
) -> Quality:
    """Assess a record's fit by its residuals, given with and without the fitted drift of the zero."""
    problem, data = result.problem, result.problem.data[k]
    record, held_out_cycles, here = data.record, data.held_out_cycles, data.joint_vector_indices
    rms_displacement = float(record.height.std())
    unit = data.unknowns.residual_unit
    residual, step = rms(without_drift) * unit, sensor_rounding_step(record.height)
    level = data.noise if problem.known_noise else None
    period = 2.0 * math.pi * data.unknowns.amplitude / data.unknowns.speed
    fitted = record.height + residuals * unit
    structure = diagnose_residuals(
        record.time, unit * without_drift, np.gradient(fitted, record.time), period
    )
    error = None
    if held_out_cycles:
        held_out_residuals = data.residuals(result.trained[here])
        error = _prediction_error_on_held_out_cycles(
            record, held_out_residuals, unit, held_out_cycles, data.training_mask
        )
    return Quality(
        residual=residual,
        relative=residual / rms_displacement,
        test_error=None if error is None else error.value,
        test_swings=[
            (float(record.time[part.start]), float(record.time[part.stop - 1])) for part in held_out_cycles
        ],
        starts=problem.starts,
        converged=result.converged,
        independent=result.independent,
        samples=len(record),
        solver_error=result.solver_errors[k],
        test_error_at_rest=None if error is None else error.at_rest,
        test_standard_error=None if error is None else error.standard_error,
        noise=noise_standard_deviation(record.height, record.time) if level is None else level,
        correlation=autocorrelation_time(without_drift),
        collocation=result.collocation,
        shifts=_relative_small_motion_changes(data.unknowns, result.theta[here], result.trained[here])
        if held_out_cycles
        else {},
        rounded=float(np.quantile(np.abs(without_drift), _ROUNDING_QUANTILE)) * unit
        <= _ROUNDING_FRACTION * step,
        zero_drift=float(np.ptp(residuals - without_drift)) * unit,
        **structure,
    )


def _relative_small_motion_changes(
    unknowns: SearchUnknowns, theta: np.ndarray, trained: np.ndarray
) -> dict[str, float]:
    """Return relative changes of period and damping ratio between two fits; empty without oscillation."""
    figures, others = (rest_height_period_and_damping(unknowns, vector) for vector in (theta, trained))
    if isinstance(figures, NoOscillationReason) or isinstance(others, NoOscillationReason):
        return {}
    pairs = zip(("period", "damping_ratio"), figures[1:], others[1:], strict=True)
    moves = {name: abs(other / figure - 1.0) for name, figure, other in pairs if figure != 0.0}
    return {name: float(by) for name, by in moves.items() if math.isfinite(by)}


def _prediction_error_on_held_out_cycles(
    record: PistonRecord,
    residuals: np.ndarray,
    unit: float,
    held_out_cycles: Sequence[slice],
    mask: np.ndarray,
) -> PredictionErrorEstimate:
    """Return a model's error on the held-out cycles; the model was fitted to the samples in the mask."""
    others = record.height[mask]
    # Displacement from the mean of the last third of the fitted samples.
    displacement = record.height - others[-len(others) // 3 :].mean()
    rms_displacement = float(record.height.std())
    misfit = residuals * unit
    error = prediction_error_on_cycles(misfit, displacement, held_out_cycles, rms_displacement)
    if any((np.abs(residuals[part]) >= DIVERGED_RESIDUAL).any() for part in held_out_cycles):
        return error._replace(value=math.inf, standard_error=None)
    return error


def residual_structure_text(quality: Quality, interval: float) -> str:
    """Describe residuals, of any size, that are not white noise; ``interval`` [s] is the sampling step."""
    correlation_text = f"are correlated over {round(quality.correlation)} samples"
    if round(quality.correlation) < 2:
        correlation_text = "are correlated"
    text = (
        f"the residuals, {100 * quality.relative:.2g} % of the rms displacement, are not white noise "
        f"(they {correlation_text}"
    )
    if abs(quality.lag) > REPORTED_LAG_FRACTION * interval and quality.swinging > OSCILLATING_FRACTION:
        text += f"; the solution lags by {quality.lag:.2g} s"
    text += quality.period_and_damping_shifts_text
    if has_sensor_drift(quality) and not quality.zero_drift:
        return f"{text}) but drift slowly, so the equilibrium is less certain; {_DRIFT_REMEDY}"
    if quality.swinging > OSCILLATING_FRACTION:
        return f"{text}) and oscillate with the motion, so the law is not right; try another law"
    return f"{text}), so the law is not right, or the noise is not white; try another law"


def has_sensor_drift(quality: Quality) -> bool:
    """Return whether residuals drift: slow changes exceed both white noise and the oscillating part."""
    return quality.drift > DRIFT_POWER_RATIO and quality.slow > quality.swinging


def _cause_of_misfit_text(quality: Quality, record: PistonRecord) -> str:
    """Name the probable cause of residuals far above the noise, and the remedy."""
    if start := release_sample_index(record):
        return (
            f"the record is at rest for the first {record.time[start] - record.time[0]:.4g} s, during which "
            "the law does not hold; fit the motion alone (reduced_models.cut_at_release)"
        )
    return "the law or the fit is not right; try another law or more starts"


def _robust_residual_size(data: FitData, residuals: np.ndarray) -> float:
    """Return the size [m] of a typical residual: the rms, or for a robust loss a value from the median."""
    if data.loss_name == "linear":
        return rms(residuals) * data.unknowns.residual_unit
    typical_residual = float(np.median(np.abs(residuals))) / NORMAL_MEDIAN
    return typical_residual * data.unknowns.residual_unit


def _release_transient_text(data: FitData, residuals: np.ndarray) -> str:
    """Describe the transient after a release; empty if the law does not fit the rest of the record."""
    without_drift = residuals * data.unknowns.residual_unit
    time, period = data.record.time, math.tau * data.unknowns.amplitude / data.unknowns.speed
    start, rms_displacement = (
        count_release_transient_samples(time, without_drift, period),
        float(data.record.height.std()),
    )
    after = rms(without_drift[start:]) / rms_displacement
    if not start or after > NEGLIGIBLE_RESIDUAL:
        return ""
    misfit, until = float(np.abs(without_drift[:start]).max()) / rms_displacement, time[start] - time[0]
    return (
        f"in the first {1e3 * until:.2g} ms after release the error of the model is up to "
        f"{100 * misfit:.2g} % of the rms displacement, later {100 * after:.2g} %"
    )


def _model_notes(
    quality: Quality, typical_residual: float, record: PistonRecord, release: str
) -> tuple[str, ...]:
    notes = []
    if quality.converged < MINIMUM_AGREEING_FRACTION * quality.starts:
        notes.append(
            f"only {quality.converged} of {quality.starts} random starts led to this fit, so there "
            "may be a better one; try more starts"
        )
    rms_displacement = quality.residual / max(quality.relative, 1e-300)
    if (
        typical_residual > NOTED_NOISE_RATIO * quality.noise
        and typical_residual > NOTED_FRACTION * rms_displacement
        and not quality.rounded
    ):
        ratio = typical_residual / quality.noise if quality.noise > 0.0 else math.inf
        notes.append(
            f"the residual is {100 * typical_residual / rms_displacement:.2g} % of the rms displacement and "
            f"{format_factor(ratio)} times the record's noise, so {_cause_of_misfit_text(quality, record)}"
        )
    elif quality.has_structured_residuals and quality.relative > ROUNDING_RESIDUAL:
        interval = float(np.median(np.diff(record.time)))
        notes.append(release or residual_structure_text(quality, interval))
    if quality.noise > NOISY_FRACTION * rms_displacement:
        notes.append(
            f"the noise is {100 * quality.noise / rms_displacement:.2g} % of the rms displacement, so the "
            "record constrains any law poorly; average more samples or measure a larger motion"
        )
    if quality.test_error == math.inf:
        notes.append("the solution diverges in the held-out cycles if the law is fitted without them")
    return tuple(notes)
