"""From a fit to a model: its numbers, how good they are, and what is to be doubted."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, format_factor, quote
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.parameter import Unknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import SearchResult, delay_remarks
from reduced_models.fitting.residual_diagnostics import (
    SLIGHT,
    autocorrelation_time,
    count_release_transient_samples,
    diagnose_residuals,
    held_at_zero_remarks,
)
from reduced_models.fitting.residuals import BLOWN_UP, remove_random_walk, rms
from reduced_models.fitting.uncertainty import (
    FitStatistics,
    Interval,
    interval_analysis,
    joint_covariance,
    marginal_information,
    physical_covariance,
    shifts_by_calibration_errors,
    small_motion_figures,
    widen_to_linear_intervals,
)
from reduced_models.laws.linearization import NoOscillation
from reduced_models.models.at_rest import AtRest, HarmonicCycle
from reduced_models.models.model import ReducedModel
from reduced_models.models.observed import stroke_cycles
from reduced_models.models.quantities import Quality
from reduced_models.records.derivatives import NORMAL_MEDIAN, noise_level, rounding_step
from reduced_models.records.envelope import (
    amplitude_remarks,
    envelope_of_extremes,
    extremes_apart,
    find_extremes,
)
from reduced_models.records.free_motion import PredictionErrorEstimate, prediction_error_on_cycles
from reduced_models.records.release import release_sample
from reduced_models.records.sensor import Sensor
from reduced_models.records.sources import describe_record

FEW = 0.25
"""Fraction of the starts that must lead to the best fit before it is taken without a note."""
# Residuals below this fraction of the swing are rounding, and the solver's: ten times `SOLVER_LIMIT`.
SMALL = 1e-5
FRACTION = 0.5
"""Fraction of the residuals' power that makes them swing with the motion."""
DRIFT = 4.0
"""Slow power of the residuals, over that of white noise, that makes a drift."""
NOISY = 0.3
"""Noise above this fraction of the swing is noted."""
VIOLENT = 500.0
"""Accelerations above this [m/s^2], fifty times gravity, are noted."""
LAG = 0.1
"""Fraction of the interval between samples: a shorter lag is not reported."""
_DRIFT_FOUND = (
    "the record's zero drifts, by {size:.2g} {unit} in all, as a random walk next to its noise: fitted with "
    "that, which the intervals allow for; FitOptions(drift=False) (fit --no-drift on the command line) "
    "leaves it out"
)
_LET_DRIFT = "fit with FitOptions(drift=True) (fit --drift on the command line)"
_NEARLY_ALL, _ROUNDED = 0.99, 0.6
"""Fraction of the residuals, and the part of the step of a sensor that rounds, half of which is its own
error, below which they show nothing but its rounding."""
NOISE_TIMES, NOTABLE = 3.0, 0.05
"""A residual above so many noise levels, and above this fraction of the swing, is noted."""


def models_from_fit(result: SearchResult, *, drift_was_found: bool = False) -> tuple[ReducedModel, ...]:
    """Reduced model of each record of a fit, with intervals, quality and notes."""
    problem, theta = result.problem, result.theta
    normal = problem.normal_matrix(theta)
    if not np.isfinite(normal).all():
        raise InputError(
            f"the fit of {quote(problem.law.name)} changes so steeply with its parameters "
            "that their intervals cannot be computed; try another law, or check the units"
        )
    residuals = tuple(problem.residuals(theta))
    covariance, independent = joint_covariance(problem, theta)
    shifts = shifts_by_calibration_errors(problem, theta)
    covariance = covariance + shifts.T @ shifts
    free = ~problem.held_entries
    profiled = None
    models = dict[int, ReducedModel]()
    motions = [
        data.record
        if data.unknowns.compares_heights
        else PistonRecord(data.record.time, data.fitted_heights(theta[data.entries]))
        for data in problem.data
    ]
    for k, data in enumerate(problem.data):
        if data.number in models:  # of which this is a further observation
            left = remove_random_walk(residuals[k], data.gain)
            model, quality = models[data.number], _assess_quality(result, k, residuals[k], left)
            qualities = {**model.qualities, data.unknowns.observation: quality}
            models[data.number] = dataclasses.replace(model, qualities=qualities)
            continue
        here, height = data.entries, motions[k].height
        known = FitStatistics(
            marginal_information(normal, here, free),
            covariance[np.ix_(here, here)],
            residuals,
            int(free.sum()),
            free[here],
            independent,
        )
        quantile = known.student_quantile(problem.confidence)
        intervals, at_rest, undetermined = interval_analysis(
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
        drift = _DRIFT_FOUND.format(size=model.quality.zero_drift, unit=model.coordinate_unit)
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
    at_rest: AtRest | NoOscillation,
    motions: Sequence[PistonRecord],
    residuals: np.ndarray,
) -> ReducedModel:
    problem, data = result.problem, result.problem.data[k]
    unknowns, record = data.unknowns, data.record
    theta = result.theta[data.entries]
    values, height, velocity, hidden = unknowns.physical_values(theta)
    left = remove_random_walk(residuals, data.gain)
    quality = _assess_quality(result, k, residuals, left)
    parameters = dict(zip(unknowns.law.parameters, map(float, values), strict=True))
    rest = None if isinstance(at_rest, NoOscillation) else at_rest
    remarks: tuple[str, ...] = ()
    if unknowns.law.inputs:
        if quality.has_structured_residuals:
            remarks = delay_remarks(problem, result.theta, k)
    else:
        fitted = record.height + residuals * unknowns.residual_unit
        rest, remarks = _what_peaks_show(rest, motions[k], fitted)
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
        no_swing=at_rest.reason if isinstance(at_rest, NoOscillation) else "",
        quality=quality,
        domain=_ranges_of_motion(motions) | observed,
        notes=(
            *_model_notes(
                quality, _robust_residual_size(data, left), record, _release_transient_text(data, left)
            ),
            *problem.notes,
            *remarks,
            *held_at_zero_remarks(
                unknowns.law,
                np.flatnonzero(~problem.held_entries[data.entries]),
                *data.linearised_residuals(theta),
            ),
            *_bound_notes(parameters, problem.bounds),
            *_suspicious_unit_notes(unknowns, record.coordinate_unit),
        ),
        provenance=_provenance_words(
            record, problem, None if isinstance(at_rest, NoOscillation) else at_rest.period
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
        cycles=_cycles_of_strokes(result, motions),
    )


def _cycles_of_strokes(result: SearchResult, motions: Sequence[PistonRecord]) -> tuple[HarmonicCycle, ...]:
    """Cycles of a force on prescribed strokes, as they were measured."""
    sensor, law = result.problem.unknowns.sensor, result.problem.law
    if not law.prescribed or sensor is None or law.observations != ("force",):
        return ()
    gain, offset = sensor.nominal_gain, sensor.nominal_offset
    return stroke_cycles(motions, [(data.record.height - offset) / gain for data in result.problem.data])


def _fitted_sensor(unknowns: Unknowns, theta: np.ndarray) -> Sensor | None:
    """Sensor with the gain and the offset of a fit."""
    if unknowns.sensor is None:
        return None
    gain, offset = unknowns.gain_and_offset(theta)
    return dataclasses.replace(unknowns.sensor, gain=gain, offset=offset)


def _what_peaks_show(
    rest: AtRest | None, record: PistonRecord, fitted: np.ndarray
) -> tuple[AtRest | None, tuple[str, ...]]:
    """Small motion, with the damping by the peaks of a free oscillation if they contradict it, and remarks.

    Peaks that are not those of the fitted motion (n,) are noise, and show no damping.
    """
    try:
        extremes = find_extremes(record)
        cycles = envelope_of_extremes(extremes)
        motion = find_extremes(PistonRecord(record.time, fitted), exact=True)
    except GranularError:  # too few of them
        return rest, ()
    peaks = cycles.peak_damping
    if rest is not None and peaks.contradicts(rest.damping_ratio) and not extremes_apart(extremes, motion):
        rest = dataclasses.replace(rest, peaks=peaks)
    low, high = (0.0, 0.0) if rest is None or rest.peaks else rest.intervals["damping_ratio"]
    return rest, amplitude_remarks(cycles, low > 0.0 or high < 0.0)


def _ranges_of_motion(records: Sequence[PistonRecord]) -> dict[str, tuple[float, float]]:
    """Ranges of height and velocity over all records of a fit."""
    heights = np.concatenate([record.height for record in records])
    speeds = np.concatenate([np.gradient(record.height, record.time) for record in records])
    return {
        "height": (float(heights.min()), float(heights.max())),
        "velocity": (float(speeds.min()), float(speeds.max())),
    }


def _provenance_words(record: PistonRecord, problem: FitProblem, period: float | None) -> dict[str, str]:
    """Origin of a model, in words: the same for the same data and settings."""
    digest = hashlib.sha256(record.time.tobytes() + record.height.tobytes()).hexdigest()
    pairs = problem.bounds.items()
    limits = [f"{low:g} <= {name} <= {high:g}" for name, (low, high) in pairs if low < high]
    limits += [f"{name} = {low:g} given" for name, (low, high) in pairs if low == high]
    bounds = ", ".join(limits)
    return {
        "data": f"{len(record)} samples over {record.time[-1] - record.time[0]:.6g} s, sha256 {digest[:16]}",
        "record": "\n".join(describe_record(record, period)),
        "records": str(1 + problem.data[-1].number),
        "fit": f"{problem.starts} starts, intervals {problem.intervals}" + (f", {bounds}" * bool(bounds)),
    }


def _bound_notes(
    parameters: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    return tuple(
        f"{name} = {parameters[name]:.5g} lies at its bound; widen the bounds or read it as given"
        for name, pair in bounds.items()
        if pair[0] < pair[1] and any(math.isclose(parameters[name], edge) for edge in pair)
    )


def _suspicious_unit_notes(unknowns: Unknowns, coordinate_unit: str) -> tuple[str, ...]:
    acceleration = unknowns.speed**2 / unknowns.amplitude
    if coordinate_unit == "rad" or acceleration < VIOLENT:
        return ()
    return (
        f"the motion accelerates at {acceleration:.2g} m/s^2; check the units of height and time, "
        "which are m and s where none are given",
    )


def _assess_quality(result: SearchResult, k: int, residuals: np.ndarray, left: np.ndarray) -> Quality:
    """Quality of a fit by its residuals, and by what is left of them without a fitted drift of the zero."""
    problem, data = result.problem, result.problem.data[k]
    record, swings, here = data.record, data.held_out_cycles, data.entries
    swing = float(record.height.std())
    unit = data.unknowns.residual_unit
    residual, step = rms(left) * unit, rounding_step(record.height)
    level = data.noise if problem.known_noise else None
    period = 2.0 * math.pi * data.unknowns.amplitude / data.unknowns.speed
    fitted = record.height + residuals * unit
    structure = diagnose_residuals(record.time, unit * left, np.gradient(fitted, record.time), period)
    error = None
    if swings:
        unseen = data.residuals(result.trained[here])
        error = _prediction_error_on_held_out_cycles(record, unseen, unit, swings, data.training_mask)
    return Quality(
        residual=residual,
        relative=residual / swing,
        test_error=None if error is None else error.value,
        test_swings=[(float(record.time[part.start]), float(record.time[part.stop - 1])) for part in swings],
        starts=problem.starts,
        converged=result.converged,
        samples=len(record),
        solver_error=result.solver_errors[k],
        test_error_at_rest=None if error is None else error.at_rest,
        test_standard_error=None if error is None else error.standard_error,
        noise=noise_level(record.height, record.time) if level is None else level,
        correlation=autocorrelation_time(left),
        collocation=result.collocation,
        shifts=_relative_small_motion_changes(data.unknowns, result.theta[here], result.trained[here])
        if swings
        else {},
        rounded=float(np.quantile(np.abs(left), _NEARLY_ALL)) * unit <= _ROUNDED * step,
        zero_drift=float(np.ptp(residuals - left)) * unit,
        **structure,
    )


def _relative_small_motion_changes(
    unknowns: Unknowns, theta: np.ndarray, trained: np.ndarray
) -> dict[str, float]:
    """Relative changes of the figures of rest between two search vectors; empty where there are none."""
    figures, others = (small_motion_figures(unknowns, vector) for vector in (theta, trained))
    if isinstance(figures, NoOscillation) or isinstance(others, NoOscillation):
        return {}
    pairs = zip(("period", "damping_ratio"), figures[1:], others[1:], strict=True)
    moves = {name: abs(other / figure - 1.0) for name, figure, other in pairs if figure != 0.0}
    return {name: float(by) for name, by in moves.items() if math.isfinite(by)}


def _prediction_error_on_held_out_cycles(
    record: PistonRecord, residuals: np.ndarray, unit: float, swings: Sequence[slice], mask: np.ndarray
) -> PredictionErrorEstimate:
    """Error on the test swings of a model that has seen the other samples, which are a mask's."""
    others = record.height[mask]
    # The level of rest at the end of what that model has seen.
    displacement = record.height - others[-len(others) // 3 :].mean()
    swing = float(record.height.std())
    missed = residuals * unit
    error = prediction_error_on_cycles(missed, displacement, swings, swing)
    if any((np.abs(residuals[part]) >= BLOWN_UP).any() for part in swings):
        return error._replace(value=math.inf, standard_error=None)
    return error


def residual_structure_text(quality: Quality, interval: float) -> str:
    """Words for residuals that are not white, however small, of samples an interval [s] apart."""
    follow = f"follow each other over {round(quality.correlation)} samples"
    if round(quality.correlation) < 2:
        follow = "are correlated"
    words = f"the residuals, {100 * quality.relative:.2g} % of the swing, are not white noise (they {follow}"
    if abs(quality.lag) > LAG * interval and quality.swinging > FRACTION:
        words += f"; the solution lags by {quality.lag:.2g} s"
    words += quality.figure_shifts_text
    if has_sensor_drift(quality) and not quality.zero_drift:
        return f"{words}) but drift slowly, so the level of rest is known less; {_LET_DRIFT}"
    if quality.swinging > FRACTION:
        return f"{words}) and swing with the motion, so the law is not right; try another law"
    return f"{words}), so the law is not right, or the noise is not white; try another law"


def has_sensor_drift(quality: Quality) -> bool:
    """Tell whether residuals are slower than the motion, and stronger there than white noise."""
    return quality.drift > DRIFT and quality.slow > quality.swinging


def _misfit_text(quality: Quality, record: PistonRecord) -> str:
    """Cause of residuals far above the noise, as far as it is seen, and the remedy."""
    if start := release_sample(record):
        return (
            f"the law is not right for all of the record: it stands still for the first "
            f"{record.time[start] - record.time[0]:.4g} s before it moves; fit it from there on "
            "(reduced_models.cut_at_release)"
        )
    return "the law or the fit is not right; try another law or more starts"


def _robust_residual_size(data: FitData, residuals: np.ndarray) -> float:
    """Residual [m] that notes go by: where the loss spares outliers, they do not count."""
    if data.loss_name == "linear":
        return rms(residuals) * data.unknowns.residual_unit
    usual = float(np.median(np.abs(residuals))) / NORMAL_MEDIAN
    return usual * data.unknowns.residual_unit


def _release_transient_text(data: FitData, residuals: np.ndarray) -> str:
    """Words on what a release stirs up, where a law holds but for that; empty elsewhere."""
    left = residuals * data.unknowns.residual_unit
    time, period = data.record.time, math.tau * data.unknowns.amplitude / data.unknowns.speed
    start, swing = count_release_transient_samples(time, left, period), float(data.record.height.std())
    after = rms(left[start:]) / swing
    if not start or after > SLIGHT:
        return ""
    missed, until = float(np.abs(left[:start]).max()) / swing, time[start] - time[0]
    return (
        f"in the first {1e3 * until:.2g} ms after release the model misses {100 * missed:.2g} % of the "
        f"displacement, {100 * after:.2g} % later"
    )


def _model_notes(quality: Quality, usual: float, record: PistonRecord, release: str) -> tuple[str, ...]:
    notes = []
    if quality.converged < FEW * quality.starts:
        notes.append(
            f"only {quality.converged} of {quality.starts} random starts led to this fit, so there "
            "may be a better one; try more starts"
        )
    swing = quality.residual / max(quality.relative, 1e-300)
    if usual > NOISE_TIMES * quality.noise and usual > NOTABLE * swing and not quality.rounded:
        ratio = usual / quality.noise if quality.noise > 0.0 else math.inf
        notes.append(
            f"the residual is {100 * usual / swing:.2g} % of the swing and {format_factor(ratio)} "
            f"times the record's noise, so {_misfit_text(quality, record)}"
        )
    elif quality.has_structured_residuals and quality.relative > SMALL:
        interval = float(np.median(np.diff(record.time)))
        notes.append(release or residual_structure_text(quality, interval))
    if quality.noise > NOISY * swing:
        notes.append(
            f"the noise is {100 * quality.noise / swing:.2g} % of the rms swing, so the record "
            "says little of any law; average more samples or measure a larger motion"
        )
    if quality.test_error == math.inf:
        notes.append("fitted without the test swings, the law diverges in them")
    return tuple(notes)
