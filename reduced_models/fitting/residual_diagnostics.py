"""Test residuals for white noise, correlation, drift and lag, and fit an autoregression to them.

Intervals use an autoregression: each residual is a weighted sum of the previous ones plus an
innovation. The weights are estimated by Burg's method (1975). A weight is kept if it improves the
likelihood by twice the penalty of the Bayesian information criterion, so that white noise is recognised
even in a hundred samples. The spectrum of the autoregression gives the noise at
the frequencies at which the solution changes with a parameter. Only that noise enters the parameter's
interval; hum at another frequency does not widen the interval.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.fitting.residuals import remove_random_walk, rms
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel

_MAXIMUM_LAGS = 40
# In autocorrelation times: Sokal's rule (1997, doi:10.1007/978-1-4899-0319-8_6). A shorter sum is biased, a
# longer one adds noise.
_WINDOW_CORRELATION_TIMES = 5.0
# Multiples of the natural frequency between which residuals oscillate with the motion.
_SLOW_LIMIT, _FAST_LIMIT = 0.3, 1.7
MAXIMUM_WEIGHTS = 40
# Multiple of the penalty of the Bayesian information criterion. At a hundred samples of white noise, 3 % of
# the weights gain more than one penalty and 0.2 % more than two; with one, intervals widen for no reason.
_PENALTY_FACTOR = 2.0
_VAIN_WEIGHTS = 8  # further weights without a gain, after which no more are tried
_MINIMUM_GAIN = 1e-4  # gain of a random walk that reaches the size of the noise in ten thousand samples
# Minimum number of samples per weight: more weights would fit single residuals.
_SAMPLES_PER_WEIGHT = 20
_MINIMUM_VARIANCE = 1e-12  # lower bound of the innovations' variance, over the residuals' variance
NEGLIGIBLE_RESIDUAL = 1e-3
"""The law is accepted if the residual after the release transient is below this fraction of the rms
displacement."""
# A residual belongs to the release transient if its power, divided by the mean power in the second and third
# periods, exceeds this: five standard deviations.
_TRANSIENT_POWER_RATIO = 25.0
_TRANSIENT_SHARE = 0.5  # minimum share of a transient in the sum of squared residuals
_REPORTED_GAIN = 0.05  # share of the sum of squared residuals that a negative parameter would remove


def diagnose_residuals(
    time: Float[np.ndarray, "n"],
    residuals: Float[np.ndarray, "n"],
    velocity: Float[np.ndarray, "n"],
    period: float,
) -> dict[str, float]:
    """Return the fields of `Quality` that describe residuals [m]."""
    from scipy.stats import norm

    count = len(residuals)
    power = float((residuals**2).sum())
    if power <= 0.0:
        return {"whiteness": 1.0, "signs": 1.0, "lag": 0.0, "slow": 0.0, "swinging": 0.0, "drift": 1.0}
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(residuals, size)) ** 2
    speed = float((velocity**2).sum())
    lines = np.fft.rfftfreq(size, float(time[-1] - time[0]) / (count - 1)) * period
    slow = float(spectrum[lines < _SLOW_LIMIT].sum() / spectrum.sum())
    swinging = float(spectrum[(lines >= _SLOW_LIMIT) & (lines <= _FAST_LIMIT)].sum() / spectrum.sum())
    return {
        "whiteness": whiteness_p_value(residuals),
        "signs": float(2.0 * norm.sf(abs(_runs_test_score(residuals)))),
        "lag": float(residuals @ velocity) / speed if speed > 0.0 else 0.0,
        "slow": slow,
        "swinging": swinging,
        "drift": slow / float((lines < _SLOW_LIMIT).mean()),
    }


def whiteness_p_value(residuals: Float[np.ndarray, "n"]) -> float:
    """Return the probability that white noise is at least as correlated as the residuals."""
    # Ljung & Box divide by the common variance. Noise that grows with the speed needs the variance of each
    # product (Dalla, Giraitis & Phillips 2022, doi:10.1017/S0266466620000341).
    from scipy.stats import chi2

    count = len(residuals)
    size, lags = 1 << (2 * count - 1).bit_length(), min(_MAXIMUM_LAGS, count // 10)
    scaled = residuals / np.abs(residuals).max()
    sums, squares = (
        np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[1 : lags + 1]
        for values in (scaled, scaled**2)
    )
    return float(chi2.sf(float((sums**2 / np.maximum(squares, 1e-300)).sum()), lags))


def autocorrelation_time(values: Float[np.ndarray, "n"]) -> float:
    """Return the integrated autocorrelation time in samples, 1 or more."""
    count = len(values)
    centred = values - values.mean()
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[:count]
    if correlation[0] <= 0.0:
        return 1.0
    sums = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    inside = np.arange(count) >= _WINDOW_CORRELATION_TIMES * np.maximum(sums, 1.0)
    window = int(np.argmax(inside)) if inside.any() else count - 1
    return max(1.0, float(sums[window]))


def _runs_test_score(residuals: np.ndarray) -> float:
    """Count runs of equal sign; return the deviation from white noise in standard deviations."""
    # Wald and Wolfowitz (1940, doi:10.1214/aoms/1177731909).
    above = residuals > 0.0
    up, down = int(above.sum()), int((~above).sum())
    count = up + down
    if not up or not down:
        return math.inf
    expected = 1.0 + 2.0 * up * down / count
    variance = (expected - 1.0) * (expected - 2.0) / (count - 1.0)
    runs = 1 + int((above[1:] != above[:-1]).sum())
    return (runs - expected) / math.sqrt(max(variance, 1e-300))


def drift_filter_gain_of_residuals(residuals: np.ndarray) -> float:
    """Return the gain of the drift filter that minimises the sum of squared innovations."""
    from scipy.optimize import minimize_scalar

    def squared_innovations(log_gain: float) -> float:
        return float((remove_random_walk(residuals, float(np.exp(log_gain))) ** 2).sum())

    solution = minimize_scalar(squared_innovations, bounds=(np.log(_MINIMUM_GAIN), 0.0), method="bounded")
    return float(np.exp(solution.x))


class Autoregression(NamedTuple):
    """Model of residuals: each is a weighted sum of the previous residuals plus an innovation."""

    weights: Float[np.ndarray, "k"]  # weights of the previous residuals, the last one first
    variance: float  # variance of the innovations

    @property
    def whitening_filter(self) -> np.ndarray:
        """Weights (k + 1,) that turn a residual and the previous ones into its innovation."""
        return np.concatenate([[1.0], -self.weights])

    def power_spectrum(self, size: int) -> Float[np.ndarray, "size//2+1"]:
        """Power (size//2 + 1,) at the frequencies of a real Fourier transform of ``size`` samples."""
        return np.asarray(self.variance / np.abs(np.fft.rfft(self.whitening_filter, size)) ** 2)


def fit_autoregression(residuals: Float[np.ndarray, "n"]) -> Autoregression:
    """Fit an autoregression to residuals (n,) about zero."""
    # Burg's reflection coefficients have moduli below 1, so the process is stable (Kay 1988, Modern Spectral
    # Estimation).
    count = len(residuals)
    power = float((residuals**2).mean())
    if power <= 0.0:
        return Autoregression(np.empty(0), 0.0)
    forward, backward = residuals[1:].copy(), residuals[:-1].copy()
    weights, variance = np.empty(0), power
    best, least = Autoregression(weights, variance), count * math.log(power)
    for order in range(1, min(MAXIMUM_WEIGHTS, count // _SAMPLES_PER_WEIGHT) + 1):
        size = float((forward**2).sum() + (backward**2).sum())
        if size <= 0.0:
            break
        reflection = 2.0 * float(forward @ backward) / size
        weights = np.append(weights - reflection * weights[::-1], reflection)
        variance = max(variance * (1.0 - reflection**2), _MINIMUM_VARIANCE * power)
        forward, backward = ((forward - reflection * backward)[1:], (backward - reflection * forward)[:-1])
        criterion = count * math.log(variance) + _PENALTY_FACTOR * order * math.log(count)
        if criterion < least:
            best, least = Autoregression(weights, variance), criterion
        if order > len(best.weights) + _VAIN_WEIGHTS:
            break
        if len(forward) < 2 or variance <= _MINIMUM_VARIANCE * power:
            break
    return _correct_autoregression_bias(best, count)


def _correct_autoregression_bias(autoregression: Autoregression, count: int) -> Autoregression:
    """Correct the weight of a first-order autoregression: residuals decorrelate faster than the noise."""
    # The bias is (1 + 3 w)/n (Marriott and Pope 1954, doi:10.1093/biomet/41.3-4.390). It matters for long
    # correlation, since the variance of a mean scales as 1/(1 - w)^2.
    if len(autoregression.weights) != 1 or autoregression.weights[0] <= 0.0:
        return autoregression
    weight = autoregression.weights[0]
    half = 0.5 * (1.0 - weight)  # at most half the distance to a random walk, w = 1
    return autoregression._replace(weights=np.array([weight + min((1.0 + 3.0 * weight) / count, half)]))


def gradient_covariance(
    slopes: Float[np.ndarray, "n p"],
    residuals: Float[np.ndarray, "n"],
    noise: Autoregression,
    speed: Float[np.ndarray, "n"] | None = None,
) -> Float[np.ndarray, "p p"]:
    """Return the covariance of the gradient J'r, for slopes J and residuals r; noise may grow with speed."""
    # Each residual is a sum of innovations of different variance: White's estimate (1980,
    # doi:10.2307/1912934) after prewhitening by an autoregression (Andrews & Monahan 1992,
    # doi:10.2307/2951574).
    from scipy.signal import lfilter

    new = lfilter(noise.whitening_filter, [1.0], residuals)
    pulled = lfilter([1.0], noise.whitening_filter, slopes[::-1], axis=0)[::-1]
    order = len(noise.weights)
    variance = noise.variance * _relative_innovation_variances(new, order, speed)
    variance[:order] = 0.0
    started = _covariance_from_unknown_past(pulled, residuals, noise)
    return np.asarray((pulled * variance[:, None]).T @ pulled) + started


def _covariance_from_unknown_past(
    pulled: Float[np.ndarray, "n p"], residuals: Float[np.ndarray, "n"], noise: Autoregression
) -> Float[np.ndarray, "p p"]:
    """Return a gradient's covariance due to unknown residuals before the record, such as the phase of hum."""
    # The first innovations contain the initial state of the residuals. Their autocovariance is taken from the
    # record, not from the weights, so it is finite even for a sharp line, whose poles are on the unit circle.
    from scipy.linalg import toeplitz

    order = len(noise.weights)
    if not order:
        return np.zeros((pulled.shape[1],) * 2)
    count = len(residuals)
    lags = np.array([residuals[: count - k] @ residuals[k:] for k in range(order)]) / count
    whitening = np.tril(toeplitz(noise.whitening_filter[:order]))
    start = whitening.T @ pulled[:order]
    return np.asarray(start.T @ toeplitz(lags) @ start)


def _relative_innovation_variances(new: np.ndarray, order: int, speed: np.ndarray | None) -> np.ndarray:
    """Model the variance of innovations, divided by its mean, as a constant plus a term in squared speed."""
    # Clock jitter gives this form. The squared innovations themselves would rest on few samples if only these
    # determine a parameter.
    result = np.ones(len(new))
    if speed is None:
        return result
    squares, power = speed[order:] ** 2, new[order:] ** 2
    about = squares - squares.mean()
    spread = float(about @ about) * float(power.mean())
    if spread > 0.0:
        growth = np.clip(float(about @ power) / spread, 0.0, 1.0 / float(squares.mean()))
        result[order:] += growth * about
    return result


def count_release_transient_samples(
    time: Float[np.ndarray, "n"], left: Float[np.ndarray, "n"], period: float
) -> int:
    """Count the samples of the transient that a release excites in addition to the oscillation."""
    # A release transient decays within the first period; residuals of a wrong law decay with the motion.
    first, third = np.searchsorted(time, time[0] + period * np.array([1.0, 3.0]))
    if third >= len(time) or first < 2:
        return 0
    power = left**2
    loud = np.flatnonzero(power[:first] > _TRANSIENT_POWER_RATIO * float(power[first:third].mean()))
    end = int(loud[-1]) + 1 if len(loud) else 0
    fades = end < first - 1 and power[:end].sum() > _TRANSIENT_SHARE * power.sum()
    return end if fades else 0


def remarks_on_parameters_held_at_zero(
    law: Law, entries: np.ndarray, residuals: np.ndarray, slopes: np.ndarray
) -> tuple[str, ...]:
    """Report parameters that the law requires to be positive but that fit the record better if negative.

    ``slopes`` (n, p) are the derivatives of the residuals (n,) with respect to the logarithms of the
    parameters; ``entries`` are the indices of the free parameters.
    """
    remarks = []
    power = float(residuals @ residuals)
    for k, name in enumerate(law.parameters):
        # a parameter near zero changes the solution by less than the residual
        if name not in law.positive or k not in entries or slopes[:, k] @ slopes[:, k] >= power:
            continue
        others = slopes[:, [j for j in entries if j != k]]
        own = slopes[:, k] / (np.linalg.norm(slopes[:, k]) or 1.0)
        own = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
        gain = float(own @ residuals)
        if gain > 0.0 and gain**2 > _REPORTED_GAIN * power * float(own @ own):
            remarks.append(
                f"{name} is held at its lower bound 0, but the record favours a negative value; to allow "
                f'negative values, use --law "{law.equation}"'
            )
    return tuple(remarks)


SIGNIFICANCE = 1e-3
"""Residuals are not white noise if the p-value is below this."""
LINE_POWER_RATIO = 3.0
"""A frequency is a spectral line if its power exceeds this multiple of the power at adjacent frequencies."""
_LINE_HALF_WIDTH = 0.15  # half-width of a line, relative to the natural frequency
_REFERENCE_HALF_WIDTH = 0.45  # half-width of the band with which a line is compared
_ROUNDING_RESIDUAL = 1e-5  # over the rms displacement: smaller residuals are rounding of solver and file


@dataclasses.dataclass(frozen=True)
class ResidualTests:
    """Size of a model's residuals, and results of tests on these residuals."""

    rms: float  # in the record's unit
    relative: float  # over the rms displacement
    whiteness: float  # probability that white noise is as correlated
    signs: float  # probability that white noise changes sign as rarely, or as often
    swing: float  # power at the natural frequency over the power next to it: about 1 for noise
    double: float  # the same at twice the frequency
    transient: float  # [s]
    after: float  # rms residual after the transient, over the rms displacement
    rounded: bool = False  # no residual exceeds the rounding step of the sensor

    @property
    def has_structure(self) -> bool:
        """True if residuals are clearly neither white noise nor rounding."""
        rounding = self.rounded or self.after <= _ROUNDING_RESIDUAL
        return not rounding and min(self.whiteness, self.signs) < SIGNIFICANCE

    @property
    def verdict(self) -> str:
        """Text that classifies the residuals as rounding, noise, or a sign of a wrong law."""
        if not self.transient:
            return self._verdict_without_transient
        slight = self.has_structure and self.after < NEGLIGIBLE_RESIDUAL
        verdict = "so the law holds there" if slight else self._verdict_without_transient
        size = f"{100.0 * self.after:.2g} % of the rms displacement"
        return f"{size} after the first {1e3 * self.transient:.3g} ms from release, {verdict}"

    @property
    def _verdict_without_transient(self) -> str:
        if self.rounded or self.after <= _ROUNDING_RESIDUAL:
            return "rounding"
        if not self.has_structure:
            return "noise"
        if self.swing > LINE_POWER_RATIO and self.swing >= self.double:
            return "wrong: the residual oscillates with the motion"
        if self.double > LINE_POWER_RATIO:
            return "wrong: the residual oscillates at twice the frequency"
        return "not white: the law is wrong, or the noise is coloured"

    def to_plain(self) -> dict[str, Any]:
        """Return the results and the verdict as plain data."""
        return {**dataclasses.asdict(self), "verdict": self.verdict}


def residual_tests(
    model: ReducedModel,
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    model_heights: Float[np.ndarray, "n"],
) -> ResidualTests:
    """Test the residuals of a model on the record that it was fitted to."""
    # Whiteness: Ljung and Box (1978, doi:10.1093/biomet/65.2.297); signs: Wald and Wolfowitz (1940,
    # doi:10.1214/aoms/1177731909); lines: the power spectrum under a Hann window.
    residuals = height - model_heights
    if model.quality.zero_drift:
        residuals = remove_random_walk(residuals, drift_filter_gain_of_residuals(residuals))
    error, size = rms(residuals), float(height.std())
    swing, double = 1.0, 1.0
    whiteness, signs, start = model.quality.whiteness, model.quality.signs, 0
    if model.at_rest is not None and error > 0.0:
        period = model.at_rest.period
        start = count_release_transient_samples(time, residuals, period)
        times, later = time[start:], residuals[start:]
        swing, double = (_spectral_line_strength(times, later, k / period) for k in (1.0, 2.0))
        if start:
            speed = np.gradient(height[start:], times)
            structure = diagnose_residuals(times, later, speed, period)
            whiteness, signs = structure["whiteness"], structure["signs"]
    return ResidualTests(
        error,
        error / size,
        whiteness,
        signs,
        swing,
        double,
        transient=float(time[start] - time[0]),
        after=rms(residuals[start:]) / size,
        rounded=model.quality.rounded,
    )


def _spectral_line_strength(time: np.ndarray, residuals: np.ndarray, frequency: float) -> float:
    """Return the mean power in a band about a frequency, divided by the mean power next to the band."""
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, residuals)
    power = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(count), 4 * count)) ** 2
    lines = np.fft.rfftfreq(4 * count, float(time[-1] - time[0]) / (count - 1)) / frequency
    inside = np.abs(lines - 1.0) <= _LINE_HALF_WIDTH
    adjacent = (np.abs(lines - 1.0) <= _REFERENCE_HALF_WIDTH) & ~inside
    if not inside.any() or not adjacent.any() or lines[-1] < 1.0 + _REFERENCE_HALF_WIDTH:
        return 1.0
    return float(power[inside].mean() / max(float(power[adjacent].mean()), 1e-300))
