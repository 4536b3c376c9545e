"""Sparse regression by PySINDy (Kaptanoglu et al. 2022, doi:10.21105/joss.03994), on smoothed derivatives."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from granular.shared.errors import import_extra
from reduced_models.discovery.terms import AnyTerm, MotionState
from reduced_models.discovery.weak_form import SmoothedMotion

_THRESHOLDS = np.geomspace(1e-3, 0.5, 24)  # of a term's share, over the size of z''


def find_supports_with_pysindy(
    motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm]
) -> list[list[int]]:
    """Find the terms, by their indices, that PySINDy keeps at each of its thresholds."""
    # As in PySINDy's guide: states (z, z') with their derivatives, inputs, the terms as a library of its own
    # making, sequentially thresholded least squares (Brunton, Proctor & Kutz 2016,
    # doi:10.1073/pnas.1517384113), whose threshold is scanned.
    pysindy = import_extra("pysindy", "method 'pysindy'", "discover")
    inner = [motion.inner for motion in motions]
    data = {
        "x": [np.stack([motion.smooth, motion.velocity], axis=1) for motion in inner],
        "t": [motion.time for motion in inner],
        "x_dot": [np.stack([motion.velocity, motion.acceleration], axis=1) for motion in inner],
        "u": [np.stack([_drive(motion), motion.time], axis=1) for motion in inner],
    }
    library = pysindy.CustomLibrary([_feature(term) for term in terms], interaction_only=True)
    size = float(np.linalg.norm(np.concatenate([motion.acceleration for motion in inner])))
    supports = []
    for threshold in size * _THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-8, normalize_columns=True)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
        with warnings.catch_warnings(action="ignore"):  # that a high threshold leaves nothing
            model.fit(**data)
        supports.append(np.flatnonzero(model.coefficients()[1]).tolist())
    return supports


def _drive(motion: SmoothedMotion) -> np.ndarray:
    return np.zeros_like(motion.time) if motion.drive is None else motion.drive


def _feature(term: AnyTerm) -> Callable[..., np.ndarray]:
    # PySINDy counts the arguments.
    return lambda z, v, u, t: term.values(MotionState(*map(np.asarray, (z, v, u, t))))
