"""`fit_force`: the law of a force that was measured on a prescribed stroke.

The motion is known, so that nothing but hidden states is solved for: they go along the smoothed
stroke, each record's from a fitted start (`reduced_models.fitting.force_search`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError, RecordError
from granular.shared.message_text import quote
from reduced_models.fitting.covariance import LEAST_DOF, joint_covariance
from reduced_models.fitting.force_search import (
    POLISHED,
    ForceFitProblem,
    ForceSearchResult,
    search_force_parameters,
)
from reduced_models.fitting.options import STARTS, TEST_FRACTION, check_fit_options
from reduced_models.fitting.parameter import Parameter, Parameters, as_parameters, parameter_settings
from reduced_models.fitting.problem import list_of_records
from reduced_models.fitting.residual_diagnostics import autocorrelation_time, diagnose_residuals
from reduced_models.laws.force_law import ForceLaw, is_force_equation, resolve_force_law
from reduced_models.least_squares.levenberg_marquardt import levenberg_marquardt
from reduced_models.least_squares.residuals import Loss
from reduced_models.models.force_model import ForceModel, stroke_cycles
from reduced_models.models.quality import Quality
from reduced_models.records.derivatives import noise_level
from reduced_models.records.inputs import column_names
from reduced_models.records.sensor import Sensor

_HARDLY = 0.25  # standard deviation of a logarithm from which on a parameter is hardly told
_UNKNOWN = math.log(1e6)  # half-width of a logarithm's interval that says nothing any more
_WRONG, _NOTABLE = 3.0, 0.05  # noise levels, and part of the force, of a residual that is noted


def is_force_fit(law: object, measured: str | Sensor | None, record: PistonRecord) -> bool:
    """Return whether a force along the heights of a record is to be fitted."""
    if isinstance(law, ForceLaw) or (isinstance(law, str) and is_force_equation(law)):
        return True
    quantity = measured.quantity if isinstance(measured, Sensor) else measured
    return (quantity or record.measured) == "force" and record.measured in ("height", "force")


def fit_force(
    record: PistonRecord | Sequence[PistonRecord],
    law: str | ForceLaw = "linear",
    *,
    parameters: Parameters | None = None,
    sensor: Sensor | None = None,
    starts: int = STARTS,
    test_fraction: float = TEST_FRACTION,
    confidence: float = 0.95,
    seed: int = 0,
) -> ForceModel:
    """Fit the law of a force to records of prescribed strokes.

    The rms difference of the forces is made least by Levenberg-Marquardt steps (Marquardt 1963,
    doi:10.1137/0111030) from many starts.

    Parameters
    ----------
    record : PistonRecord or table of one (pandas, xarray), or a sequence of them
        Records of heights [m] with a column ``force`` [N], of 20 samples at least. Several are of
        one damper, at other amplitudes and frequencies.
    law : str or ForceLaw
        Name in `FORCE_LAWS`, or an equation such as ``"force = c*z' + k*z + zero"``; names that are
        columns of the record, such as a current, are inputs, and all others are parameters.
    parameters : mapping of str to Parameter, float or str, optional
        What is known of parameters by name, as in `fit`; all records share them.
    sensor : Sensor, optional
        Load cell, with its column, and its gain and offset where they are known. The sign of an
        unknown gain follows from the energy, which a damper takes.
    starts : int
        Number of starts of the search, from 1 to 10000.
    test_fraction : float
        Fraction of each record, at its end, on which a fit to the rest is tested, from 0 to 0.9; 0
        for no test. The model that is given back is fitted to all of the record.
    confidence : float
        Confidence level of the intervals, a fraction between 0 and 1.
    seed : int
        Seed of the starts, from 0 on.

    Returns
    -------
    ForceModel
        Law with its numbers in SI units and their intervals, its residual [N], and the cycles of
        the records. The interval of a positive parameter is (0, inf) where they do not tell it.

    Raises
    ------
    RecordError
        If a table is no record, or a record has no force, lacks an input of the law, has fewer than
        20 samples, a stroke that does not move, or a force that does not change.
    InputError
        If there is no record, an argument is out of its range, there is no such law or parameter,
        the law has no parameter, the sensor has a filter or a base, or no start leads to a finite
        force.

    Warns
    -----
    UserWarning
        For each of the model's notes.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord, fit_force
    >>> time = np.linspace(0.0, 2.0, 1000)
    >>> speed = 0.09 * np.cos(9.0 * time)
    >>> record = PistonRecord(time, 0.01 * np.sin(9.0 * time), force=120.0 * speed)
    >>> round(fit_force(record).parameters["c"], 2)
    120.0
    """
    records = [item.with_time_from_zero() for item in list_of_records(record)]
    check_fit_options(starts, test_fraction, confidence, seed=seed)
    known = as_parameters(parameters)
    chosen = resolve_force_law(law, column_names(records[0]), tuple(known))
    if chosen.given and chosen.given not in known:
        level = float(np.mean([item.height.mean() for item in records]))
        known[chosen.given] = Parameter(level, fixed=True)
    settings = parameter_settings(chosen.acceleration_law, known, len(records))
    if settings.own:
        raise InputError("records of a prescribed stroke share all parameters; leave per_record out")
    field, chosen = settings.law, dataclasses.replace(chosen, positive=settings.law.positive)
    measured, notes = _measured_forces(records, sensor)
    problem = ForceFitProblem(chosen, field, tuple(records), measured.forces, settings.bounds, starts, seed)
    result = search_force_parameters(problem, settings.start)
    model = _make_model(problem, result, measured, confidence, test_fraction, notes)
    for note in model.notes:
        warnings.warn(f"fit of {chosen.name}: {note}", stacklevel=2)
    return model


class _MeasuredForces(NamedTuple):
    """Forces (n,) that move the stroke of each record [N], and the sign of those measured."""

    forces: tuple[np.ndarray, ...]
    sign: float


def _measured_forces(
    records: Sequence[PistonRecord], sensor: Sensor | None
) -> tuple[_MeasuredForces, list[str]]:
    """Return the forces of some records, and notes on them."""
    cell = Sensor("force") if sensor is None else sensor
    if not isinstance(cell, Sensor):
        raise InputError(f"sensor = {quote(cell)}; give a Sensor, such as Sensor('force')")
    if cell.filter_order or cell.absolute:
        raise InputError("a load cell on a prescribed stroke has no filter and no base; give gain and offset")
    known = isinstance(cell.gain, int | float)
    gain, offset = cell.nominal_gain, cell.nominal_offset
    forces, energy = [], 0.0
    for record in records:
        signal = cell.signal(record.columns)
        if not np.ptp(record.height) > 0.0:
            raise RecordError("the stroke of the record does not move; give one that does")
        if not np.ptp(signal) > 0.0:
            raise RecordError("the force of the record is one number; give one that changes")
        forces.append((signal - offset) / gain)
        energy += float(np.sum(0.5 * (forces[-1][1:] + forces[-1][:-1]) * np.diff(record.height)))
    if known or energy >= 0.0:
        return _MeasuredForces(tuple(forces), 1.0), []
    note = (
        "the measured force is the reaction of what is moved (its loops give energy), so its sign "
        "was turned; Sensor('force', gain=1.0) keeps it"
    )
    return _MeasuredForces(tuple(-force for force in forces), -1.0), [note]


def _make_model(
    problem: ForceFitProblem,
    result: ForceSearchResult,
    measured: _MeasuredForces,
    confidence: float,
    test_fraction: float,
    notes: list[str],
) -> ForceModel:
    """Model of a fit, with intervals from its linearisation."""
    from scipy.stats import t as student

    names, size, log = (
        problem.field.parameters,
        problem.stroke_speed_and_force_scales[2],
        problem.logarithmic_parameters,
    )
    edges = problem.search_bounds(result.units)
    held = edges.low == edges.high
    linear = problem.linearised_residuals(result.data, result.theta)
    losses, unknown = [Loss()] * len(linear), [None] * len(linear)
    covariance, independent = joint_covariance(
        linear, losses, unknown, problem.search_vector_entries, held, unknown
    )
    covariance = covariance + _calibration_covariance(problem, linear, held, measured)
    dof = min(sum(map(len, problem.forces)) - int((~held).sum()), max(LEAST_DOF, independent - 1.0))
    quantile = float(student.ppf(0.5 + 0.5 * confidence, max(1.0, dof)))
    spread = quantile * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    theta = result.theta[: len(names)]
    units = np.where(log, np.exp(np.where(log, theta, 0.0)), result.units)
    values = np.where(log, units, units * theta)
    intervals = {}
    for k, name in enumerate(names):
        ends = [
            value if spread[k] == 0.0 else theta[k] + side * spread[k]
            for side, value in ((-1, theta[k]), (1, theta[k]))
        ]
        if not log[k]:
            intervals[name] = (float(units[k] * ends[0]), float(units[k] * ends[1]))
        elif spread[k] > _UNKNOWN:
            intervals[name] = (0.0, math.inf)
        else:
            intervals[name] = (math.exp(ends[0]), math.exp(ends[1]))
    left = np.concatenate([residual for residual, _ in linear]) * size
    quality = _assess_quality(problem, result, linear, left, test_fraction)
    open_names = [name for k, name in enumerate(names) if log[k] and spread[k] > quantile * _HARDLY]
    if open_names:
        notes = [*notes, f"hardly told by these records: {', '.join(open_names)}; read their intervals"]
    notes += _quality_notes(quality)
    count = len(names)
    heights = np.concatenate([record.height for record in problem.records])
    speeds = np.concatenate([stroke.stroke.velocity for stroke in result.data])
    digest = hashlib.sha256(b"".join(item.tobytes() for item in (heights, *problem.forces))).hexdigest()
    return ForceModel(
        law=problem.law,
        parameters=dict(zip(names, map(float, values), strict=True)),
        intervals=intervals,
        confidence=confidence,
        quantile=quantile,
        covariance=covariance[:count, :count] * np.outer(units, units),
        quality=quality,
        cycles=stroke_cycles(problem.records, problem.forces),
        domain={
            "height": (float(heights.min()), float(heights.max())),
            "velocity": (float(speeds.min()), float(speeds.max())),
        },
        hidden=dict(zip(problem.field.hidden, map(float, result.theta[count:]), strict=False)),
        sign=measured.sign,
        notes=tuple(notes),
        provenance={"data": f"{len(left)} samples of {len(linear)} records, sha256 {digest[:16]}"},
    )


def _calibration_covariance(
    problem: ForceFitProblem,
    linear: Sequence[tuple[np.ndarray, np.ndarray]],
    held: np.ndarray,
    measured: _MeasuredForces,
) -> np.ndarray:
    """Covariance (q, q) by what the calibration of the load cell leaves open."""
    free = np.flatnonzero(~held)
    matrix, pulls = np.zeros((len(held), len(held))), dict[int, np.ndarray]()
    for record, (_, slopes), here in zip(problem.records, linear, problem.search_vector_entries, strict=True):
        matrix[np.ix_(here, here)] += slopes.T @ slopes
        for k, deviation in enumerate(record.deviations.get("force", ())):
            pull = pulls.setdefault(k, np.zeros(len(held)))
            pull[here] += slopes.T @ (measured.sign * deviation / problem.stroke_speed_and_force_scales[2])
    result = np.zeros_like(matrix)
    for pull in pulls.values():
        shift = np.linalg.pinv(matrix[np.ix_(free, free)], hermitian=True) @ pull[free]
        result[np.ix_(free, free)] += np.outer(shift, shift)
    return result


def _assess_quality(
    problem: ForceFitProblem,
    result: ForceSearchResult,
    linear: Sequence[tuple[np.ndarray, np.ndarray]],
    left: np.ndarray,
    test_fraction: float,
) -> Quality:
    """Quality of a fit, whose residuals (n,) are in N."""
    residual = float(np.sqrt((left**2).mean()))
    longest = max(range(len(linear)), key=lambda k: len(linear[k][0]))
    record, mine = problem.records[longest], linear[longest][0]
    period = (
        2.0 * math.pi * problem.stroke_speed_and_force_scales[0] / problem.stroke_speed_and_force_scales[1]
    )
    stroke = result.data[longest].stroke
    structure = diagnose_residuals(record.time, mine, np.gradient(stroke.velocity, record.time), period)
    pairs = zip(problem.forces, problem.records, strict=True)
    noises = [noise_level(force, item.time) for force, item in pairs]
    error, end = None, record.time[-1]
    if test_fraction > 0.0:
        error = _test_error(problem, result, test_fraction)
    return Quality(
        residual=residual,
        relative=residual / problem.stroke_speed_and_force_scales[2],
        test_error=error,
        test_swings=[] if error is None else [((1.0 - test_fraction) * float(end), float(end))],
        starts=result.starts,
        converged=result.converged,
        samples=len(left),
        solver_error=result.solver_error,
        noise=float(np.sqrt(np.mean(np.square(noises)))),
        correlation=autocorrelation_time(mine),
        collocation="none",
        test_standard_error=None,
        shifts={},
        rounded=False,
        **structure,
    )


def _test_error(problem: ForceFitProblem, result: ForceSearchResult, fraction: float) -> float:
    """Rms error at the end of the records of a fit to their beginning, in the size of the forces."""
    late = [np.arange(len(item.force)) >= (1.0 - fraction) * len(item.force) for item in result.data]
    early = [
        item._replace(weight=np.where(here, 0.0, 1.0)) for item, here in zip(result.data, late, strict=True)
    ]
    theta, _ = levenberg_marquardt(
        problem.normal_equations(early),
        np.tile(result.theta, (POLISHED, 1)),
        problem.prior(),
        1e-6,
        problem.search_bounds(result.units),
        damping=1e-6,
    )
    left = problem.linearised_residuals(result.data, theta[0])
    squares = np.concatenate([item[0][here] ** 2 for item, here in zip(left, late, strict=True)])
    return float(np.sqrt(squares.mean()))


def _quality_notes(quality: Quality) -> list[str]:
    """Return what is to be doubted of a fit."""
    notes = []
    if quality.residual > _WRONG * quality.noise and quality.relative > _NOTABLE:
        notes.append(
            f"the residual is {100.0 * quality.relative:.2g} % of the force and "
            f"{quality.residual / max(quality.noise, 1e-300):.2g} times its noise, so the law is not "
            "right; try another law"
        )
    elif quality.has_structured_residuals and quality.relative > 1e-5:
        notes.append(
            f"the residuals, {100.0 * quality.relative:.2g} % of the force, are not white noise, so "
            "the law is not quite right, or the noise is not white"
        )
    return notes
