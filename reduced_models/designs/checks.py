"""Checks of a design: figures of a damper that fell, came to rest, was lifted and released."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.records.record import PistonRecord
from granular.run.trajectory import Trajectory
from granular.studies.cases import keep_measure_name

LAW = "polynomial-spring"
"""The law that predicts the damper's swings best among those whose z is the height; its
coefficients are the spring's Taylor series about rest."""
STARTS = 8
SHOWN_EVERY = 5
"""Every fifth sample of the motion is kept for its picture."""


def _least_gap(run: Trajectory) -> float:
    from scipy.spatial.distance import pdist

    positions = run.dataset["position"].values[_resting_frame(run)]
    radii = 0.5 * run.scene.grains.diameters()
    rows, columns = np.triu_indices(len(radii), 1)
    return float((pdist(positions) / (radii[rows] + radii[columns])).min())


def _resting_frame(run: Trajectory) -> int:
    return int(np.abs(run.dataset["frame_time"].values - run.stage("drop").end).argmin())


@keep_measure_name("reduced_models.designs.study:check#2")
def measure_design_check(run: Trajectory) -> Mapping[str, Any]:
    """Heights and gaps [m], positions at rest [m], and the motion after the release as columns."""
    columns, settings = run.piston("release").with_time_from_zero().columns, run.settings()
    return {
        "rest_height": run.stage("drop").height,
        "rest_gap": _least_gap(run),
        "fall_gap": settings["closest_distance"] / run.scene.grains.species[0].diameter,
        "ledger": settings["ledger_residual"],
        "motion": {name: values.tolist() for name, values in columns.items()},
        "positions": run.dataset["position"].values[_resting_frame(run)].tolist(),
    }


def figures_of_design_check(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of a run's check, and its motion, times [s] and heights [m], for a picture."""
    from reduced_models.fitting.fit import fit

    motion = PistonRecord.from_columns(columns["motion"])
    with warnings.catch_warnings(action="ignore"):
        model = fit(motion, law=LAW, test_fraction=0.0, starts=STARTS)
    resting = model.at_rest
    return {
        **{name: value for name, value in columns.items() if name != "motion"},
        "frequency": float("nan") if resting is None else 1.0 / resting.period,
        "damping_ratio": float("nan") if resting is None else resting.damping_ratio,
        **{name: model.parameters[name] for name in ("lam", "k1", "k2", "k3")},
        "misfit": model.quality.relative,
        "times": motion.time[::SHOWN_EVERY].tolist(),
        "heights": motion.height[::SHOWN_EVERY].tolist(),
    }
