"""Fit the parameters of a law to a record by solving the law's differential equation.

The fit compares the motion itself, not its derivatives: for trial parameters the equation is solved from a
fitted initial state, and Levenberg-Marquardt changes the parameters until the solution follows the record.
The search starts from many random parameters. It fits the first two cycles, then four, eight and so on, to
avoid wrong local minima. For chaotic motions the fitted time grows in smaller steps. The result is compared
with a second estimate, from the accelerations in the record, which needs no solution of the equation. For a
law of a force, the search also starts from fits of simpler laws: the same law without its inputs, or with
inputs that act without lag.

A hysteretic or visco-elastic law has hidden states. Their values at the start of a record can be computed
from the motion measured before the record. The hidden states are integrated along that motion, starting from
zero; the error of this start value has decayed when the record starts. The resulting values depend on the
parameters, so parameters and hidden states are updated in turn until neither changes.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Concatenate, ParamSpec, Protocol, TypeGuard, cast, overload

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import CautionWarning, InputError, quote
from reduced_models.fitting.assessment import has_sensor_drift, models_from_fit
from reduced_models.fitting.fit_data import (
    FitData,
    RecordLike,
    fine_grid_over_record,
    list_of_records,
    record_from_file_or_table,
)
from reduced_models.fitting.observations import fit_data_of_observed_columns, prepare_observed_records
from reduced_models.fitting.parameter import Parameter, Parameters, parameter_settings, parameters_by_name
from reduced_models.fitting.problem import (
    STARTS,
    TEST_FRACTION,
    FitOptions,
    FitProblem,
    Initial,
    Intervals,
    check_fit_options,
    prescribed_initial_state,
)
from reduced_models.fitting.refinement import SearchResult, fit_on_verified_grids
from reduced_models.fitting.residual_diagnostics import drift_filter_gain_of_residuals, whiteness_p_value
from reduced_models.fitting.residuals import DIVERGED_RESIDUAL, LossName, remove_random_walk
from reduced_models.fitting.search import multistart_search
from reduced_models.fitting.start_values import make_acceleration_function
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law, law_from_text
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import SURE
from reduced_models.records.derivatives import fit_local_cubics
from reduced_models.records.inputs import (
    INTERPOLATIONS,
    TIME,
    has_inputs_besides_time,
    input_column,
    input_column_names,
    interpolate_inputs,
)
from reduced_models.records.sensor import Sensor, SensorQuantity

_NODES_PER_CYCLE = 128
_MAXIMUM_GAP = 1.5  # maximum gap between a history and its record, in samples
_HISTORY_ROUNDS = 20
_CONVERGED = 1e-7  # relative change of a search vector below which it has converged


def is_motion_history(initial: Initial | None) -> TypeGuard[PistonRecord | Sequence[PistonRecord]]:
    """Return whether an initial state is given as the motion before the record."""
    if isinstance(initial, Sequence) and not isinstance(initial, str) and initial:
        return all(isinstance(entry, PistonRecord) for entry in initial)
    return isinstance(initial, PistonRecord)


def prepend_histories(
    law: Law, histories: PistonRecord | Sequence[PistonRecord], records: Sequence[PistonRecord]
) -> list[PistonRecord]:
    """Prepend to each record its history, the motion measured before it; time 0 is the record's start."""
    given = [histories] if isinstance(histories, PistonRecord) else list(histories)
    if not law.hidden:
        raise InputError(
            f"the law {quote(law.name)} has no hidden state, so the motion before its record does "
            "not matter; remove the argument initial"
        )
    if len(given) != len(records):
        raise InputError(
            f"initial: {len(given)} motions for {len(records)} records; give one motion for each record"
        )
    return [_prepend_history(history, record) for history, record in zip(given, records, strict=True)]


def _prepend_history(history: PistonRecord, record: PistonRecord) -> PistonRecord:
    begin, end = float(record.time[0]), float(history.time[-1])
    step = float(record.time[-1] - begin) / (len(record) - 1)
    before = history.time < begin
    if not -0.5 * step <= begin - end <= _MAXIMUM_GAP * step or before.sum() < 2:
        raise InputError(
            f"initial: the preceding motion ends at {end:.6g} s, but the record begins at "
            f"{begin:.6g} s; cut both from one record, as record.between(0, 5) and record.between(5, 20)"
        )
    if input_column_names(history) != input_column_names(record):
        raise InputError(
            "initial: the preceding motion has other columns than the record; cut both from one record"
        )
    parts = {
        name: np.concatenate([history.columns[name][before], values])
        for name, values in record.columns.items()
        if name in history.columns
    }
    return PistonRecord.from_columns(parts | {"time": parts["time"] - begin})


def refit_with_histories(result: SearchResult, histories: Sequence[PistonRecord]) -> SearchResult:
    """Refit with each record's initial hidden states fixed at their values at the end of its history."""
    problem, theta = result.problem, result.trained
    first = len(problem.law.parameters) + 2
    for _ in range(_HISTORY_ROUNDS):
        former, theta = theta, theta.copy()
        moved = []
        for data, history in zip(problem.data, histories, strict=True):
            states = _hidden_states_at_history_end(data, theta[data.joint_vector_indices], history)
            theta[data.joint_vector_indices[first : first + len(states)]] = states
            hidden = dict(zip(problem.law.hidden, map(float, states), strict=True))
            moved.append(dataclasses.replace(data, initial={**data.initial, **hidden}))
        problem = problem.with_data(moved)
        theta = problem.refit(theta, problem.training_sample_counts, tolerance=1e-10)
        if np.abs(theta - former).max() <= _CONVERGED * max(1.0, np.abs(theta).max()):
            break
    return result.with_other_training_fit(problem, theta)


def _hidden_states_at_history_end(data: FitData, theta: np.ndarray, history: PistonRecord) -> np.ndarray:
    """Return the hidden states (h,) at the end of a history, which is at time 0."""
    law, period = data.unknowns.law, data.guess.period
    values = data.unknowns.physical_values(theta)[0]
    start = float(history.time[0])
    nodes = np.linspace(start, 0.0, max(_NODES_PER_CYCLE, round(-_NODES_PER_CYCLE * start / period)))
    motion = fit_local_cubics(history.time, history.height, period, nodes)
    motion = motion[:, motion[3] <= 0.0]
    columns = [history.time if name == TIME else input_column(history, name) for name in law.inputs]
    drive = interpolate_inputs(history.time, columns, motion[3])
    return np.asarray(make_acceleration_function(law, motion, drive)(np.array(values)[:, None])[1][-1, :, 0])


_MAXIMUM_COMPARED_SAMPLES = 2000  # samples of a record with which the interpolation of inputs is chosen
_CLEARLY_BETTER = 0.98  # fraction of the spline's error: a better interpolation must have a smaller error
_DRIFT_ROUNDS = 3
_MAXIMUM_FOUND_GAIN = 0.5  # maximum gain of a random walk that is fitted without drift=True

P = ParamSpec("P")
Records = RecordLike | Sequence[RecordLike]


class _FitFunction(Protocol[P]):
    """Type of a fit function: one record gives a model, a sequence of records gives a tuple of models."""

    @overload  # a text is one record, although it is a sequence of texts too
    def __call__(  # type: ignore[overload-overlap]
        self, record: RecordLike, /, *args: P.args, **kwargs: P.kwargs
    ) -> ReducedModel: ...
    @overload
    def __call__(
        self, record: Sequence[RecordLike], /, *args: P.args, **kwargs: P.kwargs
    ) -> tuple[ReducedModel, ...]: ...


def _return_single_model_for_single_record(
    function: Callable[Concatenate[Records, P], tuple[ReducedModel, ...]],
) -> _FitFunction[P]:
    """Make a fit function return the model itself, not a tuple, if a single record is given."""

    @functools.wraps(function)
    def fit_records(record: Records, *args: P.args, **kwargs: P.kwargs) -> Any:
        single = record_from_file_or_table(record)
        models = function(single, *args, **kwargs)
        return models[0] if isinstance(single, PistonRecord) else models

    return cast("_FitFunction[P]", fit_records)


@_return_single_model_for_single_record
def fit(
    record: Records,
    law: str | Law = "linear",
    *,
    parameters: Parameters | None = None,
    noise: Any = None,
    weights: Any = None,
    loss: LossName = "linear",
    intervals: Intervals = "linear",
    confidence: float = 0.95,
    starts: int = STARTS,
    test_fraction: float = TEST_FRACTION,
    seed: int = 0,
    options: FitOptions | None = None,
) -> tuple[ReducedModel, ...]:
    """Fit a law to a record, or to several together, through its differential equation.

    Levenberg-Marquardt searches (Marquardt 1963, doi:10.1137/0111030) from many starts minimise the
    difference between the solution of the law and the record.

    Parameters
    ----------
    record : PistonRecord, table (pandas, xarray, mapping), path, (time, height), or a list of these
        Times [s] and heights [m], or a file that `read_record` reads; samples may be irregular and have
        gaps. A fit needs 20 samples or more.
    law : str or Law
        A law of the package by its name, an equation such as ``"z'' + 2*lam*z' + k*z = g0"``, or a Law, whose
        text may hold several equations (see `Law`). The coordinate, the variable with two primes, may have
        any name; ``t`` is the time since the record's start. A name that is a column of the record is an
        input or, alone on the left side, a signal to be compared. All other names are parameters. Without an
        equation of motion the record's heights are a prescribed stroke, as on a dynamometer.
    parameters : mapping of str to Parameter, float or str, optional
        Prior knowledge of parameters by name (see `Parameter`): start values, fixed values, bounds,
        and separate values for each record. Parameters without separate values are shared by all
        records. A number alone is a start value. One parameter or more must vary. Every record has
        a separate initial state.
    noise : float or float (n,), or mapping of str to these, optional
        Standard deviation of the noise, above 0, in m or the unit of the compared signal: one number for all
        samples, or one for each sample; for several records a list. If the law observes several columns, a
        mapping gives the noise of each column by its name. If the noise is given, intervals are computed from
        it; noise given for each sample also weights the samples.
    weights : float (n,), optional
        Weights of the residuals, above 0, without unit; for several records a list of them.
    loss : "linear", "soft_l1" or "huber"
        Cost of the residuals: their squares (``"linear"``), or less than the square for residuals far
        above the noise, so that outliers have little weight (Huber 1964,
        doi:10.1214/aoms/1177703732); intervals then come from the sandwich estimate (White 1980,
        doi:10.2307/1912934).
    intervals : "linear" or "profile"
        ``"linear"``: from the linearisation at the best fit. ``"profile"``: each parameter is held at
        values further and further from the best fit and the others are refitted, which is correct also
        if parameters are bounded or strongly correlated (see
        `reduced_models.fitting.profile_likelihood`). Intervals of equilibrium, period and damping ratio
        always come from the linearisation.
    confidence : float
        Confidence level of the intervals, a fraction between 0 and 1.
    starts : int
        Number of random starts, from 1 to 10000.
    test_fraction : float
        Fraction, from 0 to 0.9, of the complete cycles of each record that are held out. They are
        spread over the cycles that rise above the noise. A first model is fitted without the held-out
        cycles, and its error is measured on these cycles. If the motion has few cycles, its end is
        held out instead. The returned model is fitted to the whole record. 0: nothing is held out.
    seed : int
        Seed of the random starts, from 0 on.
    options : FitOptions, optional
        Settings for a drift of the record's zero, interpolation of inputs, sensor and initial state.

    Returns
    -------
    ReducedModel, or a tuple of them
        One model for a single record, a tuple with one for each record of a sequence.

    Raises
    ------
    RecordError
        If a table is not a record, or a record has fewer than 20 samples to fit, does not move, or
        lacks a column that is an input of the law or that ``measured`` needs.
    InputError
        If no record is given, an argument is out of its range, a law or parameter is unknown,
        options contradict each other, every random start led to a solution that diverges, the
        solution cannot be computed to the accuracy that the fit needs, or the solution depends so
        steeply on the parameters that their intervals cannot be computed.

    Warns
    -----
    UserWarning
        For each of the model's notes, for example if few random starts led to the best fit, a parameter
        lies at its bound, or the residual is far above the record's noise.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> from reduced_models import fit
    >>> model = fit(record, law="linear")
    >>> {name: round(value, 2) for name, value in model.parameters.items()}
    {'lam': 0.8, 'omega': 21.81, 'g0': 28.55}
    >>> round(model.at_rest.period, 4), round(model.at_rest.damping_ratio, 4)
    (0.288, 0.0367)
    """
    records = list_of_records(record)
    how = FitOptions() if options is None else options
    if not isinstance(how, FitOptions):
        raise InputError(f"options = {quote(how)} is not a FitOptions; pass options=FitOptions(...)")
    check_fit_options(starts, test_fraction, confidence, intervals, loss, seed)
    declared = parameters_by_name(parameters)
    law = resolve_law(law, records[0], tuple(declared), how.measured)
    lowest = min(float(item.height.min()) for item in records)
    if law.given and lowest <= 0.0:
        raise InputError(
            f"the law {quote(law.name)} needs heights above 0, but the stroke goes down to {lowest:.3g} m; "
            "measure the stroke from the floor, or use another law"
        )
    if law.given and law.given not in declared:
        mean_height = float(np.mean([item.height.mean() for item in records]))
        declared[law.given] = Parameter(mean_height, fixed=True)
    settings = parameter_settings(law, declared, len(records))
    chosen, initial = settings.law, how.initial
    if how.drift and intervals == "profile":
        raise InputError("profile intervals do not support a drift of the zero; use intervals='linear'")
    histories = prepend_histories(chosen, initial, records) if is_motion_history(initial) else []
    state = {} if histories else prescribed_initial_state(chosen, initial)
    observed = prepare_observed_records(chosen, records, how.measured, declared, state)
    if histories and (observed.sensor is not None or chosen.observations):
        raise InputError(
            "initial: hidden states can be computed from earlier heights only if the law is fitted to "
            "heights, not to a sensor's signal or other columns; remove the argument measured or initial"
        )
    data = fit_data_of_observed_columns(
        observed, settings, test_fraction, weights, noise, loss, how.input_interpolation or "spline", state
    )
    problem = FitProblem(
        data,
        bounds=settings.bounds | dict.fromkeys(observed.held, (0.0, 0.0)),
        start=settings.start,
        known_noise=noise is not None,
        starts=starts,
        confidence=confidence,
        intervals=intervals,
        seed=seed,
        unidentified=observed.unidentified,
        notes=observed.notes,
    )
    result = multistart_search(problem)
    if not math.isfinite(result.cost):
        raise InputError(
            f"from every random start the solution of {quote(chosen.name)} diverges within the "
            "record; try another law, more starts or a shorter record"
        )
    if (
        has_inputs_besides_time(chosen.inputs)
        and not chosen.prescribed
        and how.input_interpolation is None
        and test_fraction > 0.0
    ):
        result = _choose_interpolation_and_fit(result)
    if histories:
        result = refit_with_histories(result, histories)
    if how.drift:
        result = _fit_with_drift_filter(result)
    result = fit_on_verified_grids(result)
    models = models_from_fit(result)
    if how.drift is None and intervals != "profile" and _has_random_walk_residuals(result, models):
        models = models_from_fit(fit_on_verified_grids(_fit_with_drift_filter(result)), drift_was_found=True)
    for note in dict.fromkeys(note for model in models for note in model.notes):
        warnings.warn(f"fit of {chosen.name}: {note}", CautionWarning, stacklevel=3)
    return models


def resolve_law(
    law: str | Law,
    record: PistonRecord,
    declared: Sequence[str] = (),
    measured: SensorQuantity | Sensor | None = None,
) -> Law:
    """Return the law given as a name, an equation or a Law; ``declared`` names are parameters."""
    quantity = measured.quantity if isinstance(measured, Sensor) else measured
    of_force = (quantity or record.measured) == "force" and record.measured in ("height", "force")
    chosen = law
    if isinstance(law, str):
        if "=" in law or "'" in law:
            chosen = law_from_text(law, input_column_names(record), declared)
        else:
            chosen = FORCE_LAWS[law] if of_force and law in FORCE_LAWS else law_named(law)
    if not isinstance(chosen, Law):
        raise InputError(f"law = {quote(law)} is not a law; give a name, an equation or a Law")
    if of_force and not chosen.prescribed:
        raise InputError(
            f"{quote(law if isinstance(law, str) else chosen.name)} is not a law of the force on a "
            f"prescribed stroke; give one of {', '.join(FORCE_LAWS)}, or an equation such as "
            '"force = c*z\' + k*z + zero"'
        )
    return chosen


def _choose_interpolation_and_fit(result: SearchResult) -> SearchResult:
    """Refit with the interpolation of the inputs that predicts later samples best."""
    # Each fit starts from the fit with splines, so that all end in the same minimum.
    problem = result.problem
    counts = [min(samples, _MAXIMUM_COMPARED_SAMPLES) for samples in problem.training_sample_counts]
    # One or more steps per sample: a jump of a held input within a step would spoil the solver's order.
    aligned = [
        fine_grid_over_record(problem.law, data.record, data.guess.period, "linear") for data in problem.data
    ]
    errors = {}
    for how in INTERPOLATIONS:
        trial = problem.with_data(
            dataclasses.replace(data, grid=grid, interpolation=how)
            for data, grid in zip(problem.data, aligned, strict=True)
        )
        theta = trial.refit(result.trained, counts, tolerance=1e-6)
        errors[how] = (_mean_square_residual_after(trial, theta, counts), trial)
    best = min(INTERPOLATIONS, key=lambda how: errors[how][0])
    if best == "spline" or errors[best][0] > _CLEARLY_BETTER * errors["spline"][0]:
        return result
    chosen = errors[best][1]
    return result.with_other_training_fit(
        chosen, chosen.refit(result.trained, problem.training_sample_counts)
    )


def _mean_square_residual_after(problem: FitProblem, theta: np.ndarray, counts: list[int]) -> float:
    """Return the mean squared residual of samples ``count`` to ``2 * count - 1`` of each record."""
    total, size = 0.0, 0
    for residuals, count in zip(problem.residuals(theta), counts, strict=True):
        left = residuals[count : 2 * count]
        if (np.abs(left) >= DIVERGED_RESIDUAL).any():
            return float("inf")
        total, size = total + float(left @ left), size + len(left)
    return total / max(size, 1)


def _fit_with_drift_filter(result: SearchResult) -> SearchResult:
    """Refit with a filter that removes the drift of the zero; its gains minimise the squared residuals."""
    # Exponential smoothing is the optimal filter of a random walk in white noise (Muth 1960,
    # doi:10.1080/01621459.1960.10482064); with the gain of the true ratio of both, its errors are white.
    problem, theta = result.problem, result.trained
    for _ in range(_DRIFT_ROUNDS):
        gains = map(drift_filter_gain_of_residuals, problem.residuals(theta))
        problem = problem.with_data(
            dataclasses.replace(data, gain=gain) for data, gain in zip(problem.data, gains, strict=True)
        )
        theta = problem.refit(theta, problem.training_sample_counts, tolerance=1e-6)
    return result.with_other_training_fit(problem, theta)


def _has_random_walk_residuals(result: SearchResult, models: Sequence[ReducedModel]) -> bool:
    """Return whether the residuals of a record are white noise plus a random walk."""
    for data, residuals in zip(result.problem.data, result.problem.residuals(result.theta), strict=True):
        model = models[data.number]
        quality = model.qualities.get(data.unknowns.observation, model.quality)
        if quality.rounded or not has_sensor_drift(quality):
            continue
        gain = drift_filter_gain_of_residuals(residuals)
        left = remove_random_walk(residuals, gain)
        # The misfit of a wrong law is smooth: it needs a gain near one, or is not white after the filter.
        if gain < _MAXIMUM_FOUND_GAIN and whiteness_p_value(left) > SURE:
            return True
    return False
