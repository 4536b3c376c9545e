"""Tests for noise of the residuals of a model, or for what its law misses."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from granular.shared.array_types import Float
from reduced_models.fitting.residual_diagnostics import (
    SLIGHT,
    count_release_transient_samples,
    diagnose_residuals,
    random_walk_gain,
)
from reduced_models.fitting.residuals import remove_random_walk
from reduced_models.models.model import ReducedModel

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
    rms, size = _rms(residuals), float(height.std())
    swing, double = 1.0, 1.0
    whiteness, signs, start = model.quality.whiteness, model.quality.signs, 0
    if model.at_rest is not None and rms > 0.0:
        period = model.at_rest.period
        start = count_release_transient_samples(time, residuals, period)
        times, later = time[start:], residuals[start:]
        swing, double = (_spectral_line_strength(times, later, k / period) for k in (1.0, 2.0))
        if start:
            speed = np.gradient(height[start:], times)
            structure = diagnose_residuals(times, later, speed, period)
            whiteness, signs = structure["whiteness"], structure["signs"]
    return ResidualTests(
        rms,
        rms / size,
        whiteness,
        signs,
        swing,
        double,
        transient=float(time[start] - time[0]),
        after=_rms(residuals[start:]) / size,
        rounded=model.quality.rounded,
    )


def _rms(values: np.ndarray) -> float:
    return math.sqrt(float((values**2).mean()))


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
