"""A record for a first look, its outliers drawn in.

Where a fit is to spare outliers, what it starts from must not be led by them: they are greater than
the swing's own amplitude at times, and each makes two passages through rest.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.records.first_guesses import noise_level

_WINDOW = 5  # samples whose median is compared: three of them must be sound
_FAR = 5.0  # standard deviations of the noise


def without_outliers(record: PistonRecord) -> PistonRecord:
    """The same record, samples far from the median about them moved to it.

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
