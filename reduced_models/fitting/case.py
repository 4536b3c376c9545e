"""Records to fit together, and what a fit is told about them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.least_squares.residuals import Loss, LossName
from reduced_models.records.first_guesses import FirstGuesses, first_guesses, noise_level
from reduced_models.records.inputs import Interpolation

Pairs = Mapping[str, tuple[float, float]]

_SCALES = {"linear": math.inf, "soft_l1": 1.0, "huber": 1.345}
"""Of the losses, in standard deviations of the noise: nine tenths as sharp as least squares, and
more, where the noise is normal (Holland, Welsch 1977, doi:10.1080/03610927708827533)."""
_LEAST_SCALE = 1e-6  # of a loss, in amplitudes: the residuals of a record without noise
_WINDOW = 5  # samples whose median is compared: three of them must be sound
_FAR = 5.0  # standard deviations of the noise


class Data(NamedTuple):
    """A record from time 0 on, the stretch of it that a fit may see first, and a glance at that.

    Attributes
    ----------
    record, training : PistonRecord
    stop : float
        End of the training stretch [s].
    look : PistonRecord
        The training stretch as first guesses and start values see it: without outliers, where the
        loss spares them.
    guess : FirstGuesses
    weights : float64 (n,)
        Of the residuals.
    noise : float
        Of a residual with the weight 1 [m]; where it was not given, from the record, if the loss
        asks for it.
    """

    record: PistonRecord
    training: PistonRecord
    stop: float
    look: PistonRecord
    guess: FirstGuesses
    weights: np.ndarray
    noise: float


class Case(NamedTuple):
    """Records to fit together; the one that swings the furthest sets the scales.

    Attributes
    ----------
    data : tuple of Data
    own : sequence of str
        Parameters that each record has for itself.
    bounds : mapping of str to (float, float)
        Equal ones where a parameter is given.
    start : mapping of str to float
        Where parameters are looked for.
    initial : mapping of str to float
        Height, velocity and hidden states at the start, where they are given.
    loss : str
    interpolation : str
        Of the inputs.
    known_noise : bool
        Whether the noise was given.
    each : tuple of mapping of str to float
        Parameters that are given for each record.
    """

    data: tuple[Data, ...]
    own: Sequence[str]
    bounds: Pairs
    start: Mapping[str, float]
    initial: Mapping[str, float]
    loss: LossName = "linear"
    interpolation: Interpolation = "spline"
    known_noise: bool = False
    each: tuple[Mapping[str, float], ...] = ()

    def bounds_of(self, data: Data) -> Pairs:
        """Bounds of the parameters of one of the records."""
        return {**self.bounds, **{name: (value, value) for name, value in self._own(data).items()}}

    def _own(self, data: Data) -> Mapping[str, float]:
        place = next(k for k, one in enumerate(self.data) if one is data)
        return self.each[place] if self.each else {}

    @property
    def leader(self) -> Data:
        """The record that swings the furthest."""
        return max(self.data, key=lambda data: data.guess.amplitude)

    @property
    def samples(self) -> tuple[int, ...]:
        """Of the training stretches."""
        return tuple(len(data.training) for data in self.data)

    def loss_of(self, data: Data, amplitude: float) -> Loss:
        """The loss of a record's residuals, that count in amplitudes."""
        scale = _SCALES[self.loss] * max(data.noise / amplitude, _LEAST_SCALE)
        return Loss(self.loss, scale)


def split(
    record: PistonRecord,
    holdout: float,
    weights: np.ndarray | None,
    noise: float | None,
    loss: LossName = "linear",
) -> Data:
    """A record with its training stretch."""
    whole = record.from_zero()
    stop = float(whole.time[-1]) * (1.0 - holdout)
    # Two samples make a record; what is too short to fit is told by its first guesses.
    count = max(2, int(np.searchsorted(whole.time, stop, side="right")))
    training = whole.first(count)
    given = np.ones(len(whole)) if weights is None else weights
    level = noise or 0.0
    if noise is None and loss != "linear":
        level = noise_level(whole.height, whole.time)
    look = training if loss == "linear" else without_outliers(training)
    return Data(whole, training, stop, look, first_guesses(look), given, level)


def without_outliers(record: PistonRecord) -> PistonRecord:
    """The same record, samples far from the median about them moved to it.

    What a fit starts from must not be led by outliers: they are greater than the swing's own
    amplitude at times, and each makes two passages through rest.

    Far is above five standard deviations of the noise, which third differences tell; where samples
    are so few that the motion itself goes as far between them, none is moved.
    """
    height = record.height
    if len(height) < _WINDOW:
        return record
    around = np.pad(height, _WINDOW // 2, mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(around, _WINDOW), axis=1)
    step = float(np.median(np.abs(np.diff(medians))))
    limit = _FAR * max(noise_level(height, record.time), step)
    far = np.abs(height - medians) > limit
    return dataclasses.replace(record, height=np.where(far, medians, height))
