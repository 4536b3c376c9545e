"""Structure of residuals: tests for noise, their correlation, signs and slowness, how they follow.

Intervals need an autoregression: each residual is a sum of the ones before it, with weights, and of
something new. The weights are Burg's (1975), and as many as pay twice what the Bayesian information
criterion asks: white noise is to be white, for a hundred samples too. Its spectrum says how much
noise there is at the frequencies at which the solution changes with a parameter, which is what a
parameter's interval depends on: hum at another frequency does not widen it.
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

_MOST_LAGS = 40
# In autocorrelation times: Sokal's rule (1997, doi:10.1007/978-1-4899-0319-8_6). A shorter sum is biased, a
# longer one adds noise.
_WINDOW = 5.0
_SLOW, _FAST = 0.3, 1.7  # of the swing's frequency: between them residuals swing with the motion
MOST_WEIGHTS = 40
# Times the penalty of the Bayesian information criterion: once, 3 % of weights of white noise pay it at a
# hundred samples, twice, 0.2 %. By one, intervals widen for nothing.
_PRICE = 2.0
_VAIN = 8  # further weights that gain nothing, after which no more are tried
_LEAST_GAIN = 1e-4  # a walk that gains as much as the noise in ten thousand samples
# Samples for each weight, at least: more weights would follow single residuals.
_FRACTION = 20
_LEAST = 1e-12  # of the residuals' variance: what is new in them is no less
SLIGHT = 1e-3
"""Residuals after a release, over the swing, that are said and do not make a law wrong."""
# Power of a residual after a release, over that of the two periods after the first, that makes it one of the
# release: five standard deviations.
_TRANSIENT = 25.0
_MOST_OF_IT = 0.5  # of all squared residuals, that a transient holds at least
_GAINS = 0.05  # of the squared residuals, that a parameter below zero would take away


def diagnose_residuals(
    time: Float[np.ndarray, "n"],
    residuals: Float[np.ndarray, "n"],
    velocity: Float[np.ndarray, "n"],
    period: float,
) -> dict[str, float]:
    """Structure of residuals [m] along a velocity [m/s], as fields of `quality.Quality`; time, period [s]."""
    from scipy.stats import norm

    count = len(residuals)
    power = float((residuals**2).sum())
    if power <= 0.0:
        return {"whiteness": 1.0, "signs": 1.0, "lag": 0.0, "slow": 0.0, "swinging": 0.0, "drift": 1.0}
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(residuals, size)) ** 2
    speed = float((velocity**2).sum())
    lines = np.fft.rfftfreq(size, float(time[-1] - time[0]) / (count - 1)) * period
    slow = float(spectrum[lines < _SLOW].sum() / spectrum.sum())
    swinging = float(spectrum[(lines >= _SLOW) & (lines <= _FAST)].sum() / spectrum.sum())
    return {
        "whiteness": whiteness_p_value(residuals),
        "signs": float(2.0 * norm.sf(abs(_runs_test_score(residuals)))),
        "lag": float(residuals @ velocity) / speed if speed > 0.0 else 0.0,
        "slow": slow,
        "swinging": swinging,
        "drift": slow / float((lines < _SLOW).mean()),
    }


def whiteness_p_value(residuals: Float[np.ndarray, "n"]) -> float:
    """Probability that white noise is correlated at least as much as residuals that are not all zero."""
    # Ljung & Box divide by the variance of all; noise that grows with the speed needs that of each product
    # (Dalla, Giraitis & Phillips 2022, doi:10.1017/S0266466620000341).
    from scipy.stats import chi2

    count = len(residuals)
    size, lags = 1 << (2 * count - 1).bit_length(), min(_MOST_LAGS, count // 10)
    scaled = residuals / np.abs(residuals).max()
    sums, squares = (
        np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[1 : lags + 1]
        for values in (scaled, scaled**2)
    )
    return float(chi2.sf(float((sums**2 / np.maximum(squares, 1e-300)).sum()), lags))


def autocorrelation_time(values: Float[np.ndarray, "n"]) -> float:
    """Integrated autocorrelation time, in samples; at least 1."""
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


def _runs_test_score(residuals: np.ndarray) -> float:
    """Return standard score of the number of runs of equal sign, against that of white noise."""
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


def random_walk_gain(residuals: np.ndarray) -> float:
    """Gain with the least squares of what is left."""
    from scipy.optimize import minimize_scalar

    def left(log_gain: float) -> float:
        return float((remove_random_walk(residuals, float(np.exp(log_gain))) ** 2).sum())

    solution = minimize_scalar(left, bounds=(np.log(_LEAST_GAIN), 0.0), method="bounded")
    return float(np.exp(solution.x))


class Autoregression(NamedTuple):
    """Residuals as a sum of former ones and of something new."""

    weights: Float[np.ndarray, "k"]  # of the residuals before, the last one first
    variance: float  # of what is new in each

    @property
    def whitening_filter(self) -> np.ndarray:
        """Weights (k + 1,) that leave what is new of a residual and the ones before it."""
        return np.concatenate([[1.0], -self.weights])

    def power_spectrum(self, size: int) -> Float[np.ndarray, "size//2+1"]:
        """Power (size//2 + 1,) at the frequencies of a real transform of that size."""
        return np.asarray(self.variance / np.abs(np.fft.rfft(self.whitening_filter, size)) ** 2)


def fit_autoregression(residuals: Float[np.ndarray, "n"]) -> Autoregression:
    """Autoregression of residuals (n,) about zero."""
    # Burg's reflection coefficients, below 1 in size: the process is stable (Kay 1988, Modern Spectral
    # Estimation).
    count = len(residuals)
    power = float((residuals**2).mean())
    if power <= 0.0:
        return Autoregression(np.empty(0), 0.0)
    forward, backward = residuals[1:].copy(), residuals[:-1].copy()
    weights, variance = np.empty(0), power
    best, least = Autoregression(weights, variance), count * math.log(power)
    for order in range(1, min(MOST_WEIGHTS, count // _FRACTION) + 1):
        size = float((forward**2).sum() + (backward**2).sum())
        if size <= 0.0:
            break
        reflection = 2.0 * float(forward @ backward) / size
        weights = np.append(weights - reflection * weights[::-1], reflection)
        variance = max(variance * (1.0 - reflection**2), _LEAST * power)
        forward, backward = ((forward - reflection * backward)[1:], (backward - reflection * forward)[:-1])
        criterion = count * math.log(variance) + _PRICE * order * math.log(count)
        if criterion < least:
            best, least = Autoregression(weights, variance), criterion
        if order > len(best.weights) + _VAIN:
            break
        if len(forward) < 2 or variance <= _LEAST * power:
            break
    return _correct_autoregression_bias(best, count)


def _correct_autoregression_bias(autoregression: Autoregression, count: int) -> Autoregression:
    """Single weight without its bias: residuals of a fit seem to forget sooner than the noise."""
    # By (1 + 3 w)/n (Marriott and Pope 1954, doi:10.1093/biomet/41.3-4.390). A long memory needs it: the
    # variance of a mean goes with 1/(1 - w)^2.
    if len(autoregression.weights) != 1 or autoregression.weights[0] <= 0.0:
        return autoregression
    weight = autoregression.weights[0]
    least = 0.5 * (1.0 - weight)  # no closer to a walk than half of what was found
    return autoregression._replace(weights=np.array([weight + min((1.0 + 3.0 * weight) / count, least)]))


def gradient_covariance(
    slopes: Float[np.ndarray, "n p"],
    residuals: Float[np.ndarray, "n"],
    noise: Autoregression,
    speed: Float[np.ndarray, "n"] | None = None,
) -> Float[np.ndarray, "p p"]:
    """Covariance of a gradient J'r for slopes J and residuals r, whose noise may grow with a speed."""
    # Each residual is a sum of innovations, whose sizes may differ: White (1980, doi:10.2307/1912934) behind
    # the autoregression of Andrews & Monahan (1992, doi:10.2307/2951574).
    from scipy.signal import lfilter

    new = lfilter(noise.whitening_filter, [1.0], residuals)
    pulled = lfilter([1.0], noise.whitening_filter, slopes[::-1], axis=0)[::-1]
    order = len(noise.weights)
    variance = noise.variance * _growth_with_speed(new, order, speed)
    variance[:order] = 0.0
    started = _covariance_by_start(pulled, residuals, noise)
    return np.asarray((pulled * variance[:, None]).T @ pulled) + started


def _covariance_by_start(
    pulled: Float[np.ndarray, "n p"], residuals: Float[np.ndarray, "n"], noise: Autoregression
) -> Float[np.ndarray, "p p"]:
    """Covariance of a gradient by the residuals before the first, as by the phase of hum."""
    # The first innovations hold the state that the residuals start from. Their autocovariance by the record
    # itself, not by the weights, is finite also for a sharp line, whose poles are on the unit circle.
    from scipy.linalg import toeplitz

    order = len(noise.weights)
    if not order:
        return np.zeros((pulled.shape[1],) * 2)
    count = len(residuals)
    lags = np.array([residuals[: count - k] @ residuals[k:] for k in range(order)]) / count
    whitening = np.tril(toeplitz(noise.whitening_filter[:order]))
    start = whitening.T @ pulled[:order]
    return np.asarray(start.T @ toeplitz(lags) @ start)


def _growth_with_speed(new: np.ndarray, order: int, speed: np.ndarray | None) -> np.ndarray:
    """Variance of each innovation over the mean: a constant, and a part with the speed squared."""
    # So does a clock that jitters. The squares of the innovations would do too, but rest on a few samples
    # where only these tell a parameter.
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
    """Return how many samples after a release hold what it stirred up besides the swing; time, period [s]."""
    # A release rings out within the first period; a wrong law's residuals fade with the motion instead.
    first, third = np.searchsorted(time, time[0] + period * np.array([1.0, 3.0]))
    if third >= len(time) or first < 2:
        return 0
    power = left**2
    loud = np.flatnonzero(power[:first] > _TRANSIENT * float(power[first:third].mean()))
    end = int(loud[-1]) + 1 if len(loud) else 0
    fades = end < first - 1 and power[:end].sum() > _MOST_OF_IT * power.sum()
    return end if fades else 0


def held_at_zero_remarks(
    law: Law, entries: np.ndarray, residuals: np.ndarray, slopes: np.ndarray
) -> tuple[str, ...]:
    """Name parameters that are positive by their law and that the record asks to be negative.

    ``slopes`` (n, p) are those of residuals (n,) by the logarithms of these; ``entries`` are free.
    """
    remarks = []
    power = float(residuals @ residuals)
    for k, name in enumerate(law.parameters):
        # near zero a parameter changes less than what the fit leaves
        if name not in law.positive or k not in entries or slopes[:, k] @ slopes[:, k] >= power:
            continue
        others = slopes[:, [j for j in entries if j != k]]
        own = slopes[:, k] / (np.linalg.norm(slopes[:, k]) or 1.0)
        own = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
        gain = float(own @ residuals)
        if gain > 0.0 and gain**2 > _GAINS * power * float(own @ own):
            remarks.append(
                f"{name} is held at 0, the least it may be, and the record asks for less; to let it be "
                f'negative: --law "{law.equation}"'
            )
    return tuple(remarks)


SURE = 1e-3
"""Probability below which residuals are no white noise."""
LOUD = 3.0
"""Power about a frequency, over that of the frequencies about it, which is a line."""
_BAND = 0.15  # half-width of a line, of the swing's frequency
_NEAR = 0.45  # half-width of what it is compared with
_ROUNDING = 1e-5  # of the swing: less is the solver's and the file's rounding


@dataclasses.dataclass(frozen=True)
class ResidualTests:
    """Residuals of a model, and tests of them."""

    rms: float  # in the record's unit
    relative: float  # over the rms swing
    whiteness: float  # probability that white noise is correlated as much
    signs: float  # and that it changes its sign as seldom, or as often
    swing: float  # power at the frequency over that about it: about 1 of noise
    double: float  # the same at twice the frequency
    transient: float  # [s]
    after: float  # rms after the transient, over the rms swing
    rounded: bool = False  # no residual exceeds the steps of a sensor that rounds

    @property
    def has_structure(self) -> bool:
        """True where residuals are surely no white noise, and no rounding."""
        rounding = self.rounded or self.after <= _ROUNDING
        return not rounding and min(self.whiteness, self.signs) < SURE

    @property
    def verdict(self) -> str:
        """Words on the residuals: rounding, noise, or a wrong law, and what of the release was left out."""
        if not self.transient:
            return self._verdict_without_transient
        slight = self.has_structure and self.after < SLIGHT
        verdict = "so the law holds there" if slight else self._verdict_without_transient
        left = f"{100.0 * self.after:.2g} % of the swing"
        return f"after the release's first {1e3 * self.transient:.3g} ms {left}, {verdict}"

    @property
    def _verdict_without_transient(self) -> str:
        if self.rounded or self.after <= _ROUNDING:
            return "rounding"
        if not self.has_structure:
            return "noise"
        if self.swing > LOUD and self.swing >= self.double:
            return "wrong: it swings with the motion"
        if self.double > LOUD:
            return "wrong: it swings at twice the frequency"
        return "not white: the law is wrong, or the noise is coloured"

    def to_plain(self) -> dict[str, Any]:
        """Return figures and verdict as plain data."""
        return {**dataclasses.asdict(self), "verdict": self.verdict}


def residual_tests(
    model: ReducedModel,
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    model_heights: Float[np.ndarray, "n"],
) -> ResidualTests:
    """Test the residuals of a model on the record that it was fitted to; time [s], height [m, rad]."""
    # Whiteness: Ljung and Box (1978, doi:10.1093/biomet/65.2.297); signs: Wald and Wolfowitz (1940,
    # doi:10.1214/aoms/1177731909); lines: the power spectrum under a Hann window.
    residuals = height - model_heights
    if model.quality.zero_drift:
        residuals = remove_random_walk(residuals, random_walk_gain(residuals))
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
    """Mean power in a band about a frequency, over that next to the band."""
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, residuals)
    power = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(count), 4 * count)) ** 2
    lines = np.fft.rfftfreq(4 * count, float(time[-1] - time[0]) / (count - 1)) / frequency
    inside = np.abs(lines - 1.0) <= _BAND
    adjacent = (np.abs(lines - 1.0) <= _NEAR) & ~inside
    if not inside.any() or not adjacent.any() or lines[-1] < 1.0 + _NEAR:
        return 1.0
    return float(power[inside].mean() / max(float(power[adjacent].mean()), 1e-300))
