"""Sparse regression by PySINDy: which terms an estimate of z'' calls for (Brunton, Proctor & Kutz
2016, doi:10.1073/pnas.1517384113), and how often resampled records agree (Fasel, Kutz, Brunton &
Brunton 2022, doi:10.1098/rspa.2021.0904).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from reduced_models.discovery.terms import AnyTerm, columns
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm

_THRESHOLDS = np.geomspace(1e-3, 0.5, 24)
"""On coefficients of columns of unit size, as shares of the target's size."""
_MODELS = 100
_INCLUDED = (0.9, 0.75, 0.5, 0.25)
_MOST_ROWS = 4000
_EDGE = 0.02  # of the record at each end, where derivatives are poor


class Regression:
    """A linear regression for PySINDy's optimizers, with columns and target of unit size."""

    def __init__(self, matrix: np.ndarray, target: np.ndarray) -> None:
        sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        self.matrix = matrix / sizes * np.sqrt(len(matrix))
        self.target = target / max(float(np.sqrt((target**2).mean())), 1e-300)

    def thresholded(self, threshold: float) -> Any:
        import pysindy

        return pysindy.STLSQ(threshold=float(threshold), alpha=1e-8)

    def supports(self) -> list[list[int]]:
        """Supports along a ladder of thresholds (sequentially thresholded least squares)."""
        found = []
        for threshold in _THRESHOLDS:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that a high threshold leaves nothing
                fitted = self.thresholded(threshold).fit(self.matrix, self.target[:, None])
            found.append(np.flatnonzero(fitted.coef_[0]).tolist())
        return found

    def inclusion(self, threshold: float, seed: int) -> np.ndarray:
        """Share (p,) of bootstrap resamples whose fit keeps each term."""
        import pysindy

        ensemble = pysindy.EnsembleOptimizer(
            self.thresholded(threshold), bagging=True, n_models=_MODELS
        )
        state = np.random.get_state()  # noqa: NPY002  PySINDy draws from NumPy's global generator
        np.random.seed(seed)  # noqa: NPY002
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                ensemble.fit(self.matrix, self.target[:, None])
        finally:
            np.random.set_state(state)  # noqa: NPY002
        return np.asarray(np.mean(np.stack(ensemble.coef_list)[:, 0] != 0.0, axis=0))


def strong_regression(motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm]) -> Regression:
    """The estimates of z'' against the terms, sample by sample, away from the ends."""
    rows = [_inner_rows(motion, terms, len(motions)) for motion in motions]
    matrices, targets = zip(*rows, strict=True)
    return Regression(np.concatenate(matrices), np.concatenate(targets))


def _inner_rows(
    motion: SmoothedMotion, terms: Sequence[AnyTerm], motions: int
) -> tuple[np.ndarray, np.ndarray]:
    count = len(motion.time)
    edge = int(_EDGE * count)
    rows = slice(edge, count - edge, max(1, count * motions // _MOST_ROWS))
    matrix = columns(terms, motion.smooth, motion.velocity, motion.drive)
    return matrix[rows], motion.acceleration[rows]


def weak_regression(weak: WeakForm, terms: Sequence[AnyTerm]) -> Regression:
    """The weak form, whitened for the noise of z''."""
    whitening = weak.whitening((), np.zeros(0))
    return Regression(whitening @ weak.matrix(terms), whitening @ weak.target)


def ensemble_supports(
    regression: Regression, threshold: float, seed: int
) -> tuple[list[list[int]], np.ndarray]:
    """Supports of the terms that most resamples keep, and the shares (p,) that keep each."""
    shares = regression.inclusion(threshold, seed)
    return [np.flatnonzero(shares >= least).tolist() for least in _INCLUDED], shares
