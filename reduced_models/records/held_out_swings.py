"""Whole swings of a record: those that no fit sees, and how well a law predicts them.

A law is tested where something can be lost: on whole swings that are spread over all of the motion,
while an end that has come to rest would judge nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.records.derivatives import noise_level
from reduced_models.records.first_guesses import zero_crossing_times

if TYPE_CHECKING:
    from jaxtyping import Float

_LEAST_SWING, _NOISES = 0.01, 4.0
"""Amplitude that a swing must have, over the greatest one, and in noise levels."""
_MOST_BLOCKS = 60
"""Swings of a record, above which several together are one block."""
_FEWEST_SWINGS = 10
"""Whole swings of a motion; half swings are taken where there are fewer."""
# One swing has no standard error.
_FEWEST_TESTED = 2


def find_whole_swings(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of the whole swings above the noise; time [s], height [m, rad]."""
    # The errors of two halves of a cycle are alike. Few cycles are halved, or too few parts remain for a
    # standard error; more than `_MOST_BLOCKS` parts tell no more of it.
    swing = height[:moving_samples] - height[-len(height) // 3 :].mean()
    largest = float(np.abs(swing).max())
    least = max(_LEAST_SWING * largest, _NOISES * noise_level(height, time))
    passages = zero_crossing_times(time[:moving_samples], swing, min(least, 0.5 * largest))
    passages = passages[::2] if len(passages) > 2 * _FEWEST_SWINGS else passages
    passages = passages[:: max(1, -(-len(passages) // _MOST_BLOCKS))]
    edges = np.searchsorted(time[:moving_samples], passages)
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a)


def choose_test_swings(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], fraction: float, moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of a fraction of the whole swings, evenly spread; time [s], height [m, rad]."""
    # The first one is not among them: it fixes the initial state.
    swings = find_whole_swings(time, height, moving_samples)
    passed = np.floor(fraction * np.arange(len(swings) + 1) + 0.5 + 1e-9)
    chosen = tuple(swing for swing, step in zip(swings, np.diff(passed), strict=True) if step > 0.0)
    chosen = chosen[1:] if chosen[:1] == swings[:1] else chosen
    return chosen if len(chosen) >= _FEWEST_TESTED else ()


class SwingTestError(NamedTuple):
    """Error of a law on swings that it has not seen, over the rms swing of the record."""

    value: float
    at_rest: float  # of a piston that stays at rest
    standard_error: float | None  # by its difference between swings; None of one


def error_on_swings(
    residuals: Float[np.ndarray, "n"],
    displacement: Float[np.ndarray, "n"],
    swings: Sequence[slice],
    rms_swing: float,
) -> SwingTestError:
    """Return the test error of a law, with its standard error; residuals [m, rad]."""
    # Squared errors are summed, so each swing counts by its size. The standard error is of their ratio to the
    # swings' own squares (a wrong law) or lengths (noise), whichever scatters less (ratio estimator, Cochran
    # 1977, Sampling Techniques, ch. 6).
    counts = np.array([swing.stop - swing.start for swing in swings])
    lost = np.array([float((residuals[swing] ** 2).sum()) for swing in swings])
    at_stake = np.array([float((displacement[swing] ** 2).sum()) for swing in swings])
    total, several = float(counts.sum()), len(swings)
    value, at_rest = (math.sqrt(squares.sum() / total) / rms_swing for squares in (lost, at_stake))
    if several < 2 or not 0.0 < value < math.inf or not at_rest > 0.0:
        return SwingTestError(value, at_rest, None)
    left = [lost - size * lost.sum() / size.sum() for size in (at_stake, counts)]
    spread = math.sqrt(several / (several - 1) * min(float(part @ part) for part in left)) / total
    return SwingTestError(value, at_rest, spread / (2.0 * value * rms_swing**2))
