"""Prepare the data of a fit: the column of a record to compare, the time grid and the held-out cycles."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.record import PandasOrXarray, PistonRecord
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError, RecordError
from reduced_models.fitting.levenberg_marquardt import Normal, SearchBounds
from reduced_models.fitting.parameter import Pairs, SearchUnknowns, lower_and_upper_search_bounds
from reduced_models.fitting.residuals import (
    LossName,
    ResidualLoss,
    SamplesOnGrid,
    average_samples_on_grid,
    compiled_residuals_or_normal_equations,
    grid_over_record,
    locate_samples_on_grid,
    make_normal_equations,
    remove_random_walk,
    residual_costs_and_weights,
)
from reduced_models.laws.law import Law
from reduced_models.records.derivatives import noise_standard_deviation
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.free_motion import choose_held_out_cycles
from reduced_models.records.inputs import Interpolation, StepGrid, has_inputs_besides_time
from reduced_models.records.sensor import Sensor, sensor_of_column
from reduced_models.records.sensor_artefacts import count_samples_in_motion, without_clipped_samples
from reduced_models.records.sources import read_record

_SCALES = {"linear": math.inf, "soft_l1": 1.0, "huber": 1.345}
"""Residuals above which each robust loss grows more slowly than the square, in standard deviations of the
noise. For normal noise the estimates are at least 90 % as efficient as least squares (Holland, Welsch 1977,
doi:10.1080/03610927708827533)."""
_MINIMUM_SCALE = 1e-6  # minimum scale of a loss, in amplitudes: residuals of a record without noise
# Number of samples in a running median; up to two outliers in a row do not move it.
_MEDIAN_WINDOW = 5
_OUTLIER_LIMIT = 5.0  # standard deviations of the noise
COARSE_STEPS, FINE_STEPS = 16, 64
"""Grid steps per period; the phase error per period is 4e-6 on the coarse grid and 1e-9 on the fine grid."""

Selection = int | np.ndarray | None
"""Selected samples of a record: the first ones (a number), those in a mask (n,), or all (None)."""


@dataclasses.dataclass(frozen=True, eq=False)
class FitData:
    """Data for the comparison of a law's solution with one column of a record."""

    unknowns: SearchUnknowns
    record: PistonRecord  # from time 0 on; its heights are the compared signal
    grid: StepGrid
    weights: Float[np.ndarray, "n"]
    clipped_motion: PistonRecord  # motion of the training stretch, with outliers clipped for a robust loss
    guess: FirstGuesses  # first guesses from this motion
    training: int  # number of samples that a search compares, from the first on
    interpolation: Interpolation = "spline"
    held_out_cycles: tuple[slice, ...] = ()  # cycles without weight in a first fit, which they test
    noise: float = 0.0  # [m]
    balance: float = 1.0  # part of the weights that scales several columns to equal noise
    loss_name: LossName = "linear"
    bounds: Pairs = dataclasses.field(default_factory=dict)  # of parameters, equal if one is fixed
    initial: Mapping[str, float] = dataclasses.field(default_factory=dict)  # given initial state [m, m/s]
    per_record: tuple[str, ...] = ()  # parameters with a separate value for this record
    number: int = 0  # number of the record; several of its columns may be compared
    gain: float = 0.0  # gain of the filter that removes a drift from the residuals
    means: bool = False  # whether means about the grid points replace the samples

    @functools.cached_property
    def samples(self) -> SamplesOnGrid:
        """Samples on the grid, in the form that the compiled code needs."""
        make = average_samples_on_grid if self.means else locate_samples_on_grid
        unknowns = self.unknowns
        result = make(self.record, self.grid, unknowns.law.inputs, self.interpolation, self.weights)
        if unknowns.sensor is None or unknowns.observation:
            return result
        return result.through_sensor(unknowns.sensor, self.record, self.grid)

    @functools.cached_property
    def joint_vector_indices(self) -> Int[np.ndarray, "p"]:
        """Indices of this record's entries in the joint search vector: shared entries, then separate ones."""
        names, length = self.unknowns.law.parameters, len(self.unknowns.prior_precisions)
        private = np.array([k >= len(names) or names[k] in self.per_record for k in range(length)])
        result = np.cumsum(~private) - 1
        count, shared = int(private.sum()), length - int(private.sum())
        result[private] = shared + self.number * count + np.arange(count)
        return result

    @property
    def search_bounds(self) -> SearchBounds:
        """Lower and upper bounds (p,) of the record's search vector; the two are equal for held entries."""
        return SearchBounds(*lower_and_upper_search_bounds(self.unknowns, self.bounds, self.initial))

    @property
    def training_mask(self) -> np.ndarray:
        """Mask (n,) of the samples outside the held-out cycles."""
        result = np.ones(len(self.record), dtype=bool)
        for cycle in self.held_out_cycles:
            result[cycle] = False
        return result

    @property
    def weighted_noise(self) -> float:
        """Noise [m] of the weighted residuals."""
        return self.noise * self.balance

    @property
    def loss(self) -> ResidualLoss:
        """Loss function, with its scale in the unit of the residuals."""
        level = max(self.weighted_noise / self.unknowns.residual_unit, _MINIMUM_SCALE)
        return ResidualLoss(self.loss_name, _SCALES[self.loss_name] * level)

    def residuals(self, theta: Float[np.ndarray, "p"]) -> Float[np.ndarray, "n"]:
        """Unweighted residuals (n,) of all samples, in units of the amplitude."""
        linear = compiled_residuals_or_normal_equations(self.unknowns, "linear")
        left = linear(theta, self._selected_samples(None, weighted=False), self.unknowns.scales)[0]
        return np.asarray(left)[: len(self.record)]

    def fitted_signal(self, theta: Float[np.ndarray, "p"]) -> Float[np.ndarray, "n"]:
        """Fitted signal (n,) in its unit, or fitted heights (n,) [m], from a search vector."""
        return self.record.height + self.unknowns.residual_unit * self.residuals(theta)

    def fitted_heights(self, theta: Float[np.ndarray, "p"]) -> Float[np.ndarray, "n"]:
        """Fitted heights (n,) [m] from a search vector."""
        unknowns = self.unknowns
        if unknowns.compares_heights:
            return self.fitted_signal(theta)
        if unknowns.law.prescribed:
            return self.record.extra["z"]
        # The heights are the residuals of a record that stays at equilibrium, since large residuals are
        # clipped.
        still = dataclasses.replace(self.record, height=np.full(len(self.record), unknowns.rest))
        heights = dataclasses.replace(unknowns, sensor=None, observation="")
        plain = dataclasses.replace(self, unknowns=heights, record=still)
        return plain.fitted_signal(theta[: len(theta) - unknowns.sensor_entry_count])

    def weighted_residuals_and_derivatives(
        self, theta: Float[np.ndarray, "p"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n p"]]:
        """Weighted residuals (n,) of all samples and their derivatives (n, p), after removal of any drift."""
        return self._residuals_and_derivatives_of_samples(theta, self._selected_samples(None), slice(None))

    def _residuals_and_derivatives_of_samples(
        self, theta: np.ndarray, seen: SamplesOnGrid, here: slice | np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        linear = compiled_residuals_or_normal_equations(self.unknowns, "linear")
        left, slopes = linear(theta, seen, self.unknowns.scales)
        count = len(self.record)
        value = np.asarray(left)[:count][here], np.asarray(slopes).T[:count][here]
        return remove_random_walk(value[0], self.gain), remove_random_walk(value[1], self.gain)

    def make_normal_equations(self, selection: Selection = None) -> Normal:
        """Return the normal equations of selected samples."""
        # The drift is removed for a single vector only; over samples outside the selection the random walk
        # stays constant.
        seen = self._selected_samples(selection)
        here = selection if isinstance(selection, np.ndarray) else slice(selection)
        loss = self.loss
        several = make_normal_equations(self.unknowns, seen, loss)

        def normal_equations_without_drift(theta: np.ndarray) -> tuple[np.ndarray, ...]:
            left, slopes = self._residuals_and_derivatives_of_samples(theta[0], seen, here)
            cost, weight = residual_costs_and_weights(left, loss.compiled_arguments, np)
            weighted = weight[:, None] * slopes
            return cost.sum()[None], (left @ weighted)[None], (slopes.T @ weighted)[None]

        return lambda theta: normal_equations_without_drift(theta) if len(theta) == 1 else several(theta)

    def _selected_samples(self, selection: Selection, *, weighted: bool = True) -> SamplesOnGrid:
        weight = np.zeros_like(self.samples.weight)
        here = selection if isinstance(selection, np.ndarray) else slice(selection)
        weight[: len(self.record)][here] = self.weights[here] if weighted else 1.0
        return self.samples.with_weights(weight)

    def with_column_shifted_by(self, name: str, deviation: Float[np.ndarray, "n"]) -> FitData:
        """Return the same data with a deviation (n,) added to a column of the record."""
        record = self.record
        if name in record.extra:
            record = dataclasses.replace(record, extra={**record.extra, name: record.extra[name] + deviation})
        else:
            record = dataclasses.replace(record, **{name: getattr(record, name) + deviation})
        return dataclasses.replace(self, record=record)


def fit_data_of_record(
    law: Law,
    record: PistonRecord,
    test_fraction: float,
    weights: Float[np.ndarray, "n"] | None = None,
    noise: float | None = None,
    loss: LossName = "linear",
    sensor: Sensor | None = None,
    observation: str = "",
    interpolation: Interpolation = "spline",
    *,
    about_rest: bool = False,
) -> FitData:
    """Prepare the data of a record, with its training segment and held-out cycles; ``noise`` is in m."""
    # The fraction refers to the motion, since an end at rest would not test a law. Complete cycles spread
    # over the motion are held out, or the end of the motion if it has too few cycles.
    total = record.with_time_from_zero()
    motion, prescribed = total, law.prescribed
    reading = sensor or (sensor_of_column(observation) if observation else None)
    if reading is not None:
        columns = total.columns
        if not prescribed:
            height = reading.approximate_heights(columns, about_rest=about_rest)
            # The column itself is unchanged, since a law may observe it.
            extra = {**total.extra, "height": columns.get("height", height)}
            motion = dataclasses.replace(total, height=height, extra=extra)
        total = dataclasses.replace(
            total, height=reading.signal(columns), deviations=reading.signal_deviations(total.deviations)
        )
    sound = without_clipped_samples(total)
    if sound is not total:
        seen = np.isin(total.time, sound.time)
        total, motion = (entry.with_time_from_zero() for entry in (sound, motion.select(seen)))
        weights = None if weights is None else weights[seen]
    moving_count = count_samples_in_motion(total) if test_fraction > 0.0 and not prescribed else len(total)
    stop = float(total.time[moving_count - 1]) * (1.0 - test_fraction)
    # A record needs two samples; `first_guesses` reports records that are too short to fit.
    count = max(2, int(np.searchsorted(total.time, stop, side="right")))
    given = np.ones(len(total)) if weights is None else weights
    level = noise or 0.0
    if noise is None and loss != "linear":
        level = noise_standard_deviation(total.height, total.time)
    clipped_motion = motion.first(count)
    if loss != "linear":
        clipped_motion = replace_outliers_by_running_median(clipped_motion)
    guess = first_guesses(clipped_motion.time, clipped_motion.height)
    test_cycles: tuple[slice, ...] = ()
    if test_fraction > 0.0:
        seen = motion.height if prescribed else total.height
        test_cycles = choose_held_out_cycles(total.time, seen, test_fraction, moving_count)
    if not test_cycles and len(total) - count >= 2:
        test_cycles = (slice(count, max(moving_count, count + 2)),)
    size = float(np.abs(total.height[:count] - total.height[:count].mean()).max()) if reading else 1.0
    speed = guess.amplitude * guess.frequency
    units = (1.0,) * len(law.parameters)
    unknowns = SearchUnknowns(
        law, units, guess.rest, guess.amplitude, speed, sensor, max(size, 1e-300), observation
    )
    return FitData(
        unknowns,
        total,
        fine_grid_over_record(law, total, guess.period, interpolation),
        given,
        clipped_motion,
        guess,
        count,
        interpolation,
        test_cycles,
        level,
        loss_name=loss,
    )


def fine_grid_over_record(law: Law, record: PistonRecord, period: float, how: Interpolation) -> StepGrid:
    """Return the fine grid over a record that starts at time 0."""
    # The steps of a driven law end at the samples; its grid starts coarse and is refined if the solution
    # needs it.
    wanted = law.step_ratio * (COARSE_STEPS if has_inputs_besides_time(law.inputs) else FINE_STEPS)
    return grid_over_record(record, law.inputs, period, wanted, how)


def replace_outliers_by_running_median(record: PistonRecord) -> PistonRecord:
    """Replace each sample far from the median of its neighbours by that median."""
    # Outliers may exceed the amplitude, and each adds two zero crossings. This is a Hampel filter
    # (Pearson 2002, doi:10.1109/87.974338). Its limit comes from the noise in third differences, or from the
    # step of the motion between samples if there are few.
    height = record.height
    if len(height) < _MEDIAN_WINDOW:
        return record
    around = np.pad(height, _MEDIAN_WINDOW // 2, mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(around, _MEDIAN_WINDOW), axis=1)
    step = float(np.median(np.abs(np.diff(height))))
    limit = _OUTLIER_LIMIT * max(noise_standard_deviation(height, record.time), step)
    far = np.abs(height - medians) > limit
    return dataclasses.replace(record, height=np.where(far, medians, height))


RecordLike = (
    PistonRecord | PandasOrXarray | str | Path | Mapping[str, np.ndarray] | tuple[np.ndarray, np.ndarray]
)
"""Input accepted as a record: a PistonRecord, a table, the path of a file, or a pair (time, height)."""


def record_from_table(source: Any) -> Any:
    """Turn a table, a mapping to arrays or a pair (time, height) into a record; keep anything else."""
    if (
        isinstance(source, tuple)
        and len(source) == 2
        # a table of one column is not an array of times or heights
        and all(np.ndim(values) == 1 and not hasattr(values, "equals") for values in source)
    ):
        return PistonRecord(*source)
    is_table = hasattr(source, "equals") or isinstance(source, Mapping)
    return PistonRecord.from_table(source) if is_table else source


def record_from_file_or_table(source: Any) -> Any:
    """Read a record from a file, as `read_record` does, or from a table; return anything else unchanged."""
    return read_record(source) if isinstance(source, str | Path) else record_from_table(source)


def list_of_records(record: Any) -> list[PistonRecord]:
    """Return a list of records from one record, file or table, or from a sequence of them."""
    if isinstance(single := record_from_file_or_table(record), PistonRecord):
        return [single]
    if isinstance(record, Sequence):
        records = [record_from_file_or_table(item) for item in record]
        if not records:
            raise InputError("the list of records is empty; give one record or more")
        if all(isinstance(item, PistonRecord) for item in records):
            return records
    kind = type(record).__name__
    raise InputError(
        f"a {kind} is not a record; give the path of a file, (time, height), a table, or a PistonRecord, as "
        "read_record(path) returns"
    )


def refuse_prescribed_strokes(records: Sequence[PistonRecord], action: str) -> None:
    """Refuse records of a force along a prescribed stroke."""
    for record in records:
        if record.measured == "force":
            raise RecordError(
                f"{action} needs a free or driven motion, but the stroke of this record is prescribed; "
                'for a law of its force give target="force" (--target force)'
            )


def weights_and_noise_of_records(
    records: Sequence[PistonRecord], weights: Any, noise: Any
) -> list[tuple[np.ndarray | None, float | None]]:
    """Return, for each record, the weights (n,) of the residuals and the noise [m] at weight 1."""
    if weights is not None and noise is not None and np.ndim(noise) > 0:
        raise InputError("the noise of each sample already gives its weight; remove the argument weights")
    several = len(records) > 1
    both: list[tuple[np.ndarray | None, float | None]] = []
    for k, record in enumerate(records):
        weights_of_record = _option_of_record("weights", weights, k, record, several=several)
        noise_of_record = _option_of_record("noise", noise, k, record, several=several)
        if noise_of_record is None or noise_of_record.ndim == 0:
            level = None if noise_of_record is None else float(noise_of_record)
            both.append((weights_of_record, level))
        else:
            level = float(1.0 / np.sqrt((noise_of_record**-2.0).mean()))
            both.append((level / noise_of_record, level))
    return both


def _option_of_record(
    option_name: str, given: Any, k: int, record: PistonRecord, *, several: bool
) -> np.ndarray | None:
    if given is None:
        return None
    try:
        option = np.asarray(given[k] if several and np.ndim(given) != 0 else given, dtype=np.float64)
    except (TypeError, ValueError, IndexError):
        option = np.array(np.nan)
    shapes = [record.time.shape] if option_name == "weights" else [(), record.time.shape]
    if option.shape not in shapes or not np.isfinite(option).all() or not (option > 0.0).all():
        raise InputError(
            f"{option_name}: "
            + ("for each record " if several else "")
            + f"give positive numbers, one per sample ({len(record)})"
            + (", or one for all samples" if option_name == "noise" else "")
        )
    return option
