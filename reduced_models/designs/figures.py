"""What is measured of a damper's run."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.run.trajectory import Trajectory
from granular.studies.cases import known_as

LAW = "polynomial-spring"
"""The law that predicts the damper's swings best among those without a fitted height map; its
coefficients are the spring's Taylor series about rest."""
STARTS = 8
SHOWN_EVERY = 5
"""Every fifth sample of the motion is kept for its picture."""


@known_as("reduced_models.designs.figures:damper_figures#8b0ef787")
def damper_figures(run: Trajectory) -> Mapping[str, Any]:
    """Figures of a damper that fell, came to rest, was lifted and released.

    Returns
    -------
    mapping
        ``rest_height`` [m]; ``frequency`` [Hz] of the undamped small swing about rest and
        ``damping_ratio``, by the law; its parameters ``lam``, ``k1``, ``k2``, ``k3`` (SI) and its
        rms error over the rms swing, ``misfit``; ``rest_gap`` and ``fall_gap``, the least distance
        of two grains at rest over that of their contact, and of two grains in the whole run over
        the large diameter; ``ledger``.
    """
    from reduced_models.fitting.fitting import fit

    motion = run.piston("release").from_zero()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(motion, law=LAW, holdout=0.0, starts=STARTS)
    settings = run.settings()
    resting = model.at_rest
    return {
        "rest_height": run.stage("drop").height,
        "frequency": float("nan") if resting is None else 1.0 / resting.period,
        "damping_ratio": float("nan") if resting is None else resting.damping_ratio,
        **{name: model.parameters[name] for name in ("lam", "k1", "k2", "k3")},
        "misfit": model.quality.relative,
        "rest_gap": _least_gap(run),
        "fall_gap": settings["closest_distance"] / run.scene.grains.species[0].diameter,
        "ledger": settings["ledger_residual"],
    }


def _least_gap(run: Trajectory) -> float:
    from scipy.spatial.distance import pdist

    data = run.dataset
    resting = int(np.abs(data["frame_time"].values - run.stage("drop").end).argmin())
    positions = data["position"].values[resting]
    radii = 0.5 * run.scene.grains.diameters()
    rows, columns = np.triu_indices(len(radii), 1)
    return float((pdist(positions) / (radii[rows] + radii[columns])).min())


def check_figures(run: Trajectory) -> Mapping[str, Any]:
    """`damper_figures`, and the motion after the release: ``times`` [s] and ``heights`` [m]."""
    motion = run.piston("release").from_zero()
    return {
        **damper_figures(run),
        "times": motion.time[::SHOWN_EVERY].tolist(),
        "heights": motion.height[::SHOWN_EVERY].tolist(),
    }
