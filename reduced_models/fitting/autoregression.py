"""How residuals follow each other: an autoregression, as intervals need it.

Each residual is a sum of the ones before it, with weights, and of something new. The weights are
Burg's (1975), and as many as pay twice what the Bayesian information criterion asks: white noise is
to be white, for a hundred samples too. Its spectrum says
how much noise there is at the frequencies at which the solution changes with a parameter, which is
what a parameter's interval depends on: hum at another frequency does not widen it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

MOST_WEIGHTS = 40
_PRICE = 2.0
_VAIN = 8  # further weights that gain nothing, after which no more are tried
_SHARE = 20  # samples for each weight, at least
_LEAST = 1e-12  # of the residuals' variance: what is new in them is no less


class Autoregression(NamedTuple):
    """Residuals as a sum of former ones and of something new.

    Attributes
    ----------
    weights : float64 (k,)
        Of the residuals before, the last one first.
    variance : float
        Of what is new in each.
    """

    weights: np.ndarray
    variance: float

    @property
    def filter(self) -> np.ndarray:
        """Weights (k + 1,) that leave what is new of a residual and the ones before it."""
        return np.concatenate([[1.0], -self.weights])

    def spectrum(self, size: int) -> np.ndarray:
        """Power (size//2 + 1,) at the frequencies of a real transform of that size."""
        return np.asarray(self.variance / np.abs(np.fft.rfft(self.filter, size)) ** 2)

    def new(self, residuals: np.ndarray) -> np.ndarray:
        """What is new in residuals (n,), from the first that has enough before it on."""
        found = np.convolve(residuals, self.filter)[: len(residuals)]
        return np.asarray(found[len(self.weights) :])


def autoregression(residuals: np.ndarray) -> Autoregression:
    """That of residuals (n,) about zero."""
    count = len(residuals)
    power = float((residuals**2).mean())
    if power <= 0.0:
        return Autoregression(np.empty(0), 0.0)
    forward, backward = residuals[1:].copy(), residuals[:-1].copy()
    weights, variance = np.empty(0), power
    best, least = Autoregression(weights, variance), count * math.log(power)
    for order in range(1, min(MOST_WEIGHTS, count // _SHARE) + 1):
        size = float((forward**2).sum() + (backward**2).sum())
        if size <= 0.0:
            break
        reflection = 2.0 * float(forward @ backward) / size
        weights = np.append(weights - reflection * weights[::-1], reflection)
        variance = max(variance * (1.0 - reflection**2), _LEAST * power)
        forward, backward = (
            (forward - reflection * backward)[1:],
            (backward - reflection * forward)[:-1],
        )
        criterion = count * math.log(variance) + _PRICE * order * math.log(count)
        if criterion < least:
            best, least = Autoregression(weights, variance), criterion
        if order > len(best.weights) + _VAIN:
            break
        if len(forward) < 2 or variance <= _LEAST * power:
            break
    return _remembering(best, count)


def _remembering(found: Autoregression, count: int) -> Autoregression:
    """A single weight without its bias: residuals of a fit seem to forget sooner than the noise.

    By (1 + 3 w) / n (Marriott and Pope 1954, doi:10.1093/biomet/41.3-4.390), which the level of a
    long memory feels: its variance goes with 1 / (1 - w)^2.
    """
    if len(found.weights) != 1 or found.weights[0] <= 0.0:
        return found
    weight = found.weights[0]
    least = 0.5 * (1.0 - weight)  # no closer to a walk than half of what was found
    return found._replace(weights=np.array([weight + min((1.0 + 3.0 * weight) / count, least)]))


def spread_of(slopes: np.ndarray, noise: Autoregression) -> np.ndarray:
    """J' S J (p, p) for slopes J (n, p) and the covariance S of the residuals."""
    from scipy.fft import next_fast_len, rfft

    if not len(noise.weights):
        return np.asarray(noise.variance * slopes.T @ slopes)
    size = next_fast_len(2 * len(slopes), real=True)
    lines = rfft(np.ascontiguousarray(slopes.T), size)
    weight = noise.spectrum(size)
    weight[1 : (size + 1) // 2] *= 2.0
    return np.asarray(((weight * lines) @ lines.conj().T).real / size)
