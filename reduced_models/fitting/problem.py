"""The problem that a fit solves: a law, the records that it is fitted to, and all that is asked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from granular.run.piston_record import PandasOrXarray, PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models.fitting.residuals import Loss, LossName
from reduced_models.laws.law import Law
from reduced_models.records.derivatives import noise_level
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.held_out_swings import choose_test_swings
from reduced_models.records.inputs import Interpolation
from reduced_models.records.sensor import Sensor
from reduced_models.records.sensor_artefacts import count_samples_in_motion, without_clipped_samples
from reduced_models.records.sources import read_record

if TYPE_CHECKING:
    from jaxtyping import Float

RecordLike = (
    PistonRecord | PandasOrXarray | str | Path | Mapping[str, np.ndarray] | tuple[np.ndarray, np.ndarray]
)
"""A record, a table of one, the name of its file, or its times and heights."""
Pairs = Mapping[str, tuple[float, float]]
Intervals = Literal["linear", "profile"]

_SCALES = {"linear": math.inf, "soft_l1": 1.0, "huber": 1.345}
"""Scales of the losses, in standard deviations of the noise: nine tenths as sharp as least squares,
and more, where the noise is normal (Holland, Welsch 1977, doi:10.1080/03610927708827533)."""
_LEAST_SCALE = 1e-6  # of a loss, in amplitudes: the residuals of a record without noise
# Samples whose median is compared; up to two outliers in a row do not move it.
_WINDOW = 5
_FAR = 5.0  # standard deviations of the noise


class TrainingData(NamedTuple):
    """A record from time 0 on, the stretch that a search sees, and the swings that judge a law."""

    record: PistonRecord
    training: PistonRecord
    test_swings: tuple[slice, ...]  # without weight in a first fit, which they judge
    look: PistonRecord  # training stretch for first guesses, outliers clipped if the loss spares them
    guess: FirstGuesses
    weights: Float[np.ndarray, "n"]
    noise: float  # [m]
    fixed: Mapping[str, float] = {}  # parameters that are given for this record alone
    observation: str = ""  # of the law, that the heights of record and training are
    number: int = 0  # of the record, of which there may be several observations
    balance: float = 1.0  # part of the weights that makes several observations count by their noise

    @property
    def weighted_noise(self) -> float:
        """Noise [m] of the weighted residuals."""
        return self.noise * self.balance


@dataclasses.dataclass(frozen=True, eq=False)
class FitProblem:
    """Records to fit together, and what is asked; see `reduced_models.fitting.fit.fit`."""

    law: Law
    data: tuple[TrainingData, ...]
    own: tuple[str, ...]  # parameters that each record has for itself
    bounds: Pairs
    start: Mapping[str, float]  # values about which parameters are looked for
    initial: Mapping[str, float]  # [m, m/s]
    loss: LossName
    interpolation: Interpolation
    known_noise: bool
    starts: int
    confidence: float
    intervals: Intervals
    seed: int
    sensor: Sensor | None = None
    notes: tuple[str, ...] = ()  # on the data
    untold: tuple[str, ...] = ()  # by the signal; level: height of rest, size: size of the motion

    def bounds_of_record(self, data: TrainingData) -> Pairs:
        """Bounds of the parameters of one of the records."""
        return {**self.bounds, **{name: (value, value) for name, value in data.fixed.items()}}

    @property
    def largest_swing_record(self) -> TrainingData:
        """The record that swings the furthest."""
        return max(self.data, key=lambda data: data.guess.amplitude)

    @property
    def samples(self) -> tuple[int, ...]:
        """Number of samples of each training stretch."""
        return tuple(len(data.training) for data in self.data)

    @property
    def training_masks(self) -> tuple[np.ndarray, ...]:
        """Samples (n,) of each record that its test swings leave, as a mask."""
        masks = tuple(np.ones(len(data.record), dtype=bool) for data in self.data)
        for data, mask in zip(self.data, masks, strict=True):
            for swing in data.test_swings:
                mask[swing] = False
        return masks

    @property
    def noise(self) -> tuple[float | None, ...]:
        """Noise [m] of each record, None unless it was given."""
        return tuple(data.noise if self.known_noise else None for data in self.data)

    @property
    def weighted_noise(self) -> tuple[float | None, ...]:
        """Noise [m] of each record's weighted residuals, None unless it was given."""
        return tuple(data.weighted_noise if self.known_noise else None for data in self.data)

    def loss_of_record(self, data: TrainingData, unit: float) -> Loss:
        """Loss of a record's residuals, which count in a unit; data, unit [m]."""
        scale = _SCALES[self.loss] * max(data.weighted_noise / unit, _LEAST_SCALE)
        return Loss(self.loss, scale)


def split_training_data(
    record: PistonRecord,
    test_fraction: float,
    weights: Float[np.ndarray, "n"] | None = None,
    noise: float | None = None,
    loss: LossName = "linear",
    fixed: Mapping[str, float] | None = None,
    sensor: Sensor | None = None,
    *,
    about_rest: bool = False,
    prescribed: bool = False,
) -> TrainingData:
    """Split a record into its training stretch and test swings, and take a glance at it; noise [m]."""
    # The fraction is one of the motion: an end at rest would say nothing of a law. It is whole swings spread
    # over the motion, or its end if there are too few of them.
    total = record.with_time_from_zero()
    motion = total
    if sensor is not None:
        columns = total.columns
        if not prescribed:
            height = sensor.approximate_heights(columns, about_rest=about_rest)
            # The column stays as it is, for what a law says of it.
            extra = {**total.extra, "height": columns.get("height", height)}
            motion = dataclasses.replace(total, height=height, extra=extra)
        total = dataclasses.replace(
            total, height=sensor.signal(columns), deviations=sensor.signal_deviations(total.deviations)
        )
    sound = without_clipped_samples(total)
    if sound is not total:
        seen = np.isin(total.time, sound.time)
        total, motion = (entry.with_time_from_zero() for entry in (sound, motion.select(seen)))
        weights = None if weights is None else weights[seen]
    moving = count_samples_in_motion(total) if test_fraction > 0.0 and not prescribed else len(total)
    stop = float(total.time[moving - 1]) * (1.0 - test_fraction)
    # Two samples make a record; what is too short to fit is reported by its first guesses.
    count = max(2, int(np.searchsorted(total.time, stop, side="right")))
    training = total.first(count)
    given = np.ones(len(total)) if weights is None else weights
    level = noise or 0.0
    if noise is None and loss != "linear":
        level = noise_level(total.height, total.time)
    look = motion.first(count)
    if loss != "linear":
        look = clip_outliers(look)
    guess = first_guesses(look.time, look.height)
    swings: tuple[slice, ...] = ()
    if test_fraction > 0.0:
        seen = motion.height if prescribed else total.height
        swings = choose_test_swings(total.time, seen, test_fraction, moving)
    if not swings and len(total) - count >= 2:
        swings = (slice(count, max(moving, count + 2)),)
    return TrainingData(total, training, swings, look, guess, given, level, fixed or {})


def clip_outliers(record: PistonRecord) -> PistonRecord:
    """Move samples of a record that are far from the median about them to it."""
    # Outliers may be larger than the amplitude, and each makes two passages through rest. A Hampel filter
    # (Pearson 2002, doi:10.1109/87.974338), its limit by the noise in third differences, or by the motion's
    # own step if samples are few.
    height = record.height
    if len(height) < _WINDOW:
        return record
    around = np.pad(height, _WINDOW // 2, mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(around, _WINDOW), axis=1)
    step = float(np.median(np.abs(np.diff(height))))
    limit = _FAR * max(noise_level(height, record.time), step)
    far = np.abs(height - medians) > limit
    return dataclasses.replace(record, height=np.where(far, medians, height))


def record_from_table(source: Any) -> Any:
    """Record in a table, in a mapping of names to arrays or in a pair (time, height); else the source."""
    if isinstance(source, tuple) and len(source) == 2 and all(map(_is_plain_array, source)):
        return PistonRecord(*source)
    is_table = hasattr(source, "equals") or isinstance(source, Mapping)
    return PistonRecord.from_table(source) if is_table else source


def _is_plain_array(values: Any) -> bool:
    """Return whether values are one column, and no table of a column."""
    return np.ndim(values) == 1 and not hasattr(values, "equals")


def read_given_record(source: Any) -> Any:
    """Record in a file, as `read_record` reads it, or in a table; anything else as it is."""
    return read_record(source) if isinstance(source, str | Path) else record_from_table(source)


def list_of_records(record: Any) -> list[PistonRecord]:
    """One record, file or table, or a sequence of them, as a list of records."""
    if isinstance(single := read_given_record(record), PistonRecord):
        return [single]
    if isinstance(record, Sequence):
        records = [read_given_record(item) for item in record]
        if not records:
            raise InputError("there is no record to fit; give at least one")
        if all(isinstance(item, PistonRecord) for item in records):
            return records
    kind = type(record).__name__
    raise InputError(
        f"a {kind} is no record; give a file's name, (time, height), a table, or a PistonRecord, such as "
        "read_record(path) gives"
    )


def refuse_prescribed_strokes(records: Sequence[PistonRecord], action: str) -> None:
    """Refuse records of a force along a prescribed stroke."""
    for record in records:
        if record.measured == "force":
            raise RecordError(
                f"{action} is of free or driven motions, and the stroke of this record is prescribed; "
                'for a law of its force give target="force" (--target force)'
            )


def weights_and_noise(
    records: Sequence[PistonRecord], weights: Any, noise: Any
) -> list[tuple[np.ndarray | None, float | None]]:
    """Weights (n,) of each record's residuals, and the noise [m] of one with the weight 1."""
    if weights is not None and noise is not None and np.ndim(noise) > 0:
        raise InputError("noise of each sample gives their weights; leave weights out")
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
    what: str, given: Any, k: int, record: PistonRecord, *, several: bool
) -> np.ndarray | None:
    if given is None:
        return None
    try:
        own = np.asarray(given[k] if several and np.ndim(given) != 0 else given, dtype=np.float64)
    except (TypeError, ValueError, IndexError):
        own = np.array(np.nan)
    shapes = [record.time.shape] if what == "weights" else [(), record.time.shape]
    if own.shape not in shapes or not np.isfinite(own).all() or not (own > 0.0).all():
        raise InputError(
            f"{what}: give positive numbers, one a sample ({len(record)})"
            + (", or one for all" if what == "noise" else "")
            + (", for each record" if several else "")
        )
    return own
