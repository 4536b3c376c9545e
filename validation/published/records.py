"""What is written down of each run: enough to compute every figure later, without the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.observables import (
    force_magnitudes,
    interaction_forces,
    pair_distance_series,
)
from granular.run.trajectory import StageResult, Trajectory

STROKE_SAMPLES = 51
"""Samples of the piston force on the way down, and as many on the way up."""

DAMPER_EVERY = 10
"""Every tenth sample of the damper's motion is written down."""


def bed_record(run: Trajectory) -> Mapping[str, Any]:
    """The state before and at full compression, and the course of force and mean distance.

    Returns
    -------
    mapping
        ``start``, ``full``: positions (n, 2) [m]; ``start_height``, ``full_height`` [m];
        ``magnitudes``: of the magnetic force on each grain at full compression (n,) [N];
        ``down``, ``up``: piston force on even steps of the stroke [N]; ``half_distances`` [m] of
        the frames from the start of the compression on, and their ``times`` in T; ``seconds``,
        ``steps``, ``ledger``.
    """
    relax, compress = run.stage("relax"), run.stage("compress")
    period = compress.end - compress.start
    first, full = _frame_at(run, relax.end), _frame_at(run, compress.end)
    positions = run.dataset["position"].values
    settings = run.settings()
    times = run.dataset["frame_time"].values
    return {
        "start": np.round(positions[first], 9).tolist(),
        "full": np.round(positions[full], 9).tolist(),
        "start_height": relax.height,
        "full_height": compress.height,
        "magnitudes": force_magnitudes(interaction_forces(run).values[full]).tolist(),
        "down": _force_in(run, compress),
        "up": _force_in(run, run.stages[2]) if len(run.stages) > 2 else [],
        "times": ((times[first:] - relax.end) / period).tolist(),
        "half_distances": (0.5 * pair_distance_series(run).values[first:]).tolist(),
        "seconds": settings["seconds"],
        "steps": settings["steps"],
        "ledger": settings["ledger_residual"],
    }


def damper_record(run: Trajectory) -> Mapping[str, Any]:
    """Rest height, and what two laws fitted to the motion after the lift say.

    Returns
    -------
    mapping
        ``rest_height``, ``nudge`` [m]; of the linear law ``period`` [s] and ``damping_ratio``; of
        the source's Van der Pol-like law ``alpha``, ``omega``, ``g0``, its rms error ``misfit``
        over the rms swing and that of the linear one, and the greatest factor ``open`` by which
        its interval of alpha spans; ``times`` [s] and ``heights`` [m]; ``seconds``, ``steps``,
        ``ledger``.
    """
    from reduced_models import fit

    motion = run.piston("release").from_zero()
    rest = run.stage("drop").height
    linear, source = fit(motion, law="linear"), fit(motion, law="van-der-pol-like")
    settings = run.settings()
    low, high = source.intervals["alpha"]
    return {
        "rest_height": rest,
        "nudge": float(motion.height[0]) - rest,
        "period": float("nan") if linear.at_rest is None else linear.at_rest.period,
        "damping_ratio": float("nan") if linear.at_rest is None else linear.at_rest.damping_ratio,
        "linear_misfit": linear.quality.relative,
        "misfit": source.quality.relative,
        **{name: source.parameters[name] for name in ("alpha", "omega", "g0")},
        "open": high / low if low > 0.0 else float("inf"),
        "times": motion.time[::DAMPER_EVERY].tolist(),
        "heights": motion.height[::DAMPER_EVERY].tolist(),
        "seconds": settings["seconds"],
        "steps": settings["steps"],
        "ledger": settings["ledger_residual"],
    }


def _frame_at(run: Trajectory, time: float) -> int:
    return int(np.abs(run.dataset["frame_time"].values - time).argmin())


def _force_in(run: Trajectory, stage: StageResult) -> list[float]:
    """The piston force at even distances in time, which are even distances of the stroke."""
    samples = np.linspace(stage.start, stage.end, STROKE_SAMPLES)
    data = run.dataset
    found = np.interp(samples, data["time"].values, data["piston_force"].values)
    return [float(one) for one in found]
