"""Error of a derived law's motion in comparison with a free oscillation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.models.model import ReducedModel
from reduced_models.records.envelope import find_extremes

CYCLES = 10
"""Number of cycles of the recorded motion, from its second extreme, that are compared with the law."""


class MotionError(NamedTuple):
    """Error of a law's motion that starts at the second extreme of a recorded motion.

    Attributes
    ----------
    relative : float
        Rms difference of the heights, divided by the record's rms displacement from the law's
        equilibrium.
    mean_shift : float
        Mean height of the law's motion minus the mean recorded height [m].
    rms : float
        Rms difference of the heights [m].
    samples : int
        Number of samples compared.
    """

    relative: float
    mean_shift: float
    rms: float
    samples: int


def motion_error(model: ReducedModel, record: PistonRecord) -> MotionError:
    """Compare a model with a free oscillation over ten cycles from its second extreme."""
    extremes, rest = find_extremes(record), model.at_rest
    if rest is None or len(extremes) < 2:
        raise RecordError(
            f"the motion has {len(extremes)} extremes, but 2 are needed; give a free oscillation"
        )
    start, height = float(extremes.time[1]), float(extremes.height[1])
    chosen = (record.time > start) & (record.time <= start + CYCLES * rest.period)
    seen = record.height[chosen]
    difference = model.simulate(np.append(start, record.time[chosen]), height, 0.0).height[1:] - seen
    rms = float(np.sqrt((difference**2).mean()))
    displacement = float(np.sqrt(((seen - rest.height) ** 2).mean()))
    return MotionError(rms / displacement, float(difference.mean()), rms, len(seen))
