"""Motion behind a record without a position: velocity or acceleration, integrated.

An integral of a measured signal drifts. What is slower than a fraction of the strongest line of the
signal is taken out, in both directions of time (Butterworth), so that the motion is about zero and
knows no level: good for pictures, frequencies and first guesses, not for fits of a law.
"""

from __future__ import annotations

import numpy as np

from granular.shared.array_types import Float

_SLOW = 0.2  # of the strongest frequency: what is slower is taken out
_PADDING = 0.5  # periods of the slowest that stays, laid on each end


def integrate_without_drift(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], repeats: int
) -> Float[np.ndarray, "n"]:
    """Integrate a measured signal in time, once or twice, with its slow drift taken out; time [s]."""
    from scipy.integrate import cumulative_trapezoid
    from scipy.signal import butter, sosfiltfilt

    count = len(time)
    even = np.linspace(time[0], time[-1], count)
    step = float(time[-1] - time[0]) / (count - 1)
    result = np.interp(even, time, values)
    result = result - result.mean()
    spectrum = np.abs(np.fft.rfft(result * np.hanning(count)))
    peak = max(2, int(spectrum.argmax()))
    corner = _SLOW * peak / count  # in samples' frequency
    slow = butter(2, 2.0 * corner, "highpass", output="sos")
    padding = min(count - 1, round(_PADDING / corner))
    for _ in range(repeats):
        result = step * cumulative_trapezoid(result, initial=0.0)
        result = sosfiltfilt(slow, result, padlen=padding)
    return np.asarray(np.interp(time, even, result))
