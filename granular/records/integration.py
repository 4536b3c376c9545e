"""Displacement of a record without a position, integrated from the velocity or acceleration.

The integral of a measured signal drifts. A Butterworth high-pass filter, run forwards and backwards in
time, therefore removes frequencies below a fraction of the signal's dominant frequency. The displacement
then has zero mean and gives no absolute height. It is suitable for plots, frequencies and initial guesses,
but not for fits of a law.
"""

from __future__ import annotations

import numpy as np

from granular.shared.array_types import Float

_CUT_OFF_FRACTION = 0.2  # cut-off frequency over the strongest frequency
_PADDING = 0.5  # padding of each end, in periods of the cut-off frequency


def integrate_without_drift(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], repeats: int
) -> Float[np.ndarray, "n"]:
    """Integrate a measured signal over time [s], once or twice, and remove the slow drift."""
    from scipy.integrate import cumulative_trapezoid
    from scipy.signal import butter, sosfiltfilt

    count = len(time)
    even = np.linspace(time[0], time[-1], count)
    step = float(time[-1] - time[0]) / (count - 1)
    result = np.interp(even, time, values)
    result = result - result.mean()
    spectrum = np.abs(np.fft.rfft(result * np.hanning(count)))
    peak = max(2, int(spectrum.argmax()))
    corner = _CUT_OFF_FRACTION * peak / count  # in cycles per sample
    high_pass = butter(2, 2.0 * corner, "highpass", output="sos")
    padding = min(count - 1, round(_PADDING / corner))
    for _ in range(repeats):
        result = step * cumulative_trapezoid(result, initial=0.0)
        result = sosfiltfilt(high_pass, result, padlen=padding)
    return np.asarray(np.interp(time, even, result))
