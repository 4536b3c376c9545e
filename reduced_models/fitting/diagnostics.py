"""Structure of residuals: their correlation, their signs, and how slow they are."""

from __future__ import annotations

import math

import numpy as np

_MOST_LAGS = 40
_WINDOW = 5.0  # of the autocorrelation time, Sokal's rule
_SLOW, _FAST = 0.3, 1.7  # of the swing's frequency: between them residuals swing with the motion


def diagnostics(
    time: np.ndarray, residuals: np.ndarray, velocity: np.ndarray, period: float
) -> dict[str, float]:
    """Structure of residuals, as fields of `reduced_models.models.quality.Quality`.

    Parameters
    ----------
    time : float64 (n,)
        [s]
    residuals : float64 (n,)
        Solution minus data [m].
    velocity : float64 (n,)
        Of the motion [m/s].
    period : float
        Of the motion [s].

    Returns
    -------
    dict of str to float
        ``whiteness`` and ``signs``, the tests of Ljung and Box (1978, doi:10.1093/biomet/65.2.297)
        and of Wald and Wolfowitz (1940, doi:10.1214/aoms/1177731909); ``lag`` [s], ``slow``,
        ``swinging``, ``drift``.
    """
    from scipy.stats import chi2, norm

    count = len(residuals)
    power = float((residuals**2).sum())
    if power <= 0.0:
        return {
            "whiteness": 1.0, "signs": 1.0, "lag": 0.0, "slow": 0.0, "swinging": 0.0, "drift": 1.0
        }  # fmt: skip
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(residuals, size)) ** 2
    lags = min(_MOST_LAGS, count // 10)
    correlation = np.fft.irfft(spectrum, size)[1 : lags + 1] / power
    box = count * (count + 2.0) * float((correlation**2 / (count - np.arange(1, lags + 1))).sum())
    speed = float((velocity**2).sum())
    lines = np.fft.rfftfreq(size, float(time[-1] - time[0]) / (count - 1)) * period
    slow = float(spectrum[lines < _SLOW].sum() / spectrum.sum())
    swinging = float(spectrum[(lines >= _SLOW) & (lines <= _FAST)].sum() / spectrum.sum())
    return {
        "whiteness": float(chi2.sf(box, lags)),
        "signs": float(2.0 * norm.sf(abs(_sign_score(residuals)))),
        "lag": float(residuals @ velocity) / speed if speed > 0.0 else 0.0,
        "slow": slow,
        "swinging": swinging,
        "drift": slow / float((lines < _SLOW).mean()),
    }


def autocorrelation_time(values: np.ndarray) -> float:
    """Integrated autocorrelation time, in samples; at least 1.

    A. Sokal (1997), doi:10.1007/978-1-4899-0319-8_6.
    """
    count = len(values)
    centred = values - values.mean()
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[:count]
    if correlation[0] <= 0.0:
        return 1.0
    sums = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    inside = np.arange(count) >= _WINDOW * np.maximum(sums, 1.0)
    window = int(np.argmax(inside)) if inside.any() else count - 1
    return max(1.0, float(sums[window]))


def _sign_score(residuals: np.ndarray) -> float:
    """How many standard deviations the number of runs of one sign is off that of white noise."""
    above = residuals > 0.0
    up, down = int(above.sum()), int((~above).sum())
    count = up + down
    if not up or not down:
        return math.inf
    expected = 1.0 + 2.0 * up * down / count
    variance = (expected - 1.0) * (expected - 2.0) / (count - 1.0)
    runs = 1 + int((above[1:] != above[:-1]).sum())
    return (runs - expected) / math.sqrt(max(variance, 1e-300))
