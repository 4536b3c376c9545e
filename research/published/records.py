"""Stored records of each run, from which all figures can be computed later without another run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.observables import least_piston_distance, per_frame
from granular.run.trajectory import StageResult, Trajectory
from granular.studies.cases import keep_measure_name

STROKE_SAMPLES = 201
"""Number of samples of the piston force on the way down, and as many on the way up."""

SWING_SPAN, SWING_SAMPLES = 4.0, 801
"""Maximum duration of a stored motion of the damper [s], and its number of samples."""

PRESSED = 110.0
"""Maximum force on the piston in de Paula's experiment [N] [D, 4.2.2]."""


@keep_measure_name("validation.measured_quantities.records:bed_record, 2")
def measure_bed_states_and_curves(run: Trajectory) -> Mapping[str, Any]:
    """Return the states before and after compression and at the end, and the curves between them.

    Returns
    -------
    mapping
        ``start``, ``full``, ``end``: positions (n, 2) [m] with ``start_height``, ``full_height``,
        ``end_height`` [m] (before and at full compression, and at the end of the run);
        ``forces``: magnetic force plus weight on each grain at full compression (n, 2) [N];
        ``down``, ``up``: piston force at equal steps of the stroke [N]; ``walls``: the force on
        every wall before and at full compression [N]; of the frames from the start of the
        compression on, ``times`` in T, ``half_distances`` and smallest ``piston_distances`` [m];
        ``cost``: ``seconds``, ``steps``, ``ledger``, and versions.
    """
    relax, compress = run.stage("relax"), run.stage("compress")
    period = compress.end - compress.start
    first, full = _nearest_frame_index(run, relax.end), _nearest_frame_index(run, compress.end)
    positions = run.dataset["position"].values
    heights = run.dataset["frame_height"].values
    times = run.dataset["frame_time"].values
    return {
        "start": _rounded_positions(positions[first]),
        "full": _rounded_positions(positions[full]),
        "end": _rounded_positions(positions[-1]),
        "start_height": relax.height,
        "full_height": compress.height,
        "end_height": float(heights[-1]),
        "forces": np.round(run.dataset["force"].values[full], 9).tolist(),
        "down": _force_over_stage(run, compress),
        "up": _force_over_stage(run, run.stages[2]) if len(run.stages) > 2 else [],
        "walls": {
            name: [
                _interpolate_scalar_at(run, name, relax.end),
                _interpolate_scalar_at(run, name, compress.end),
            ]
            for name in ("left_force", "right_force", "bottom_force", "piston_force")
            if name in run.dataset
        },
        "times": ((times[first:] - relax.end) / period).tolist(),
        "half_distances": (0.5 * per_frame(run, "mean_distance").values[first:]).tolist(),
        "piston_distances": [
            least_piston_distance(positions[k], float(heights[k])) for k in range(first, len(times))
        ],
        **_run_cost_and_versions(run),
    }


@keep_measure_name("validation.measured_quantities.records:pressed_record, 1")
def measure_state_at_pressing_force(run: Trajectory) -> Mapping[str, Any]:
    """Return the state at which the force on the piston first reached `PRESSED`, if it did.

    Returns
    -------
    mapping
        ``pressed``: positions (n, 2) [m] of the nearest frame; ``pressed_height`` [m],
        ``pressed_force`` [N] there; ``greatest``, the maximum force of the run [N]; and the cost.
    """
    force = run.dataset["piston_force"].values
    reached = np.flatnonzero(force >= PRESSED)
    time = float(run.dataset["time"].values[reached[0] if len(reached) else force.argmax()])
    frame = _nearest_frame_index(run, time)
    at = float(run.dataset["frame_time"].values[frame])
    return {
        "pressed": _rounded_positions(run.dataset["position"].values[frame]),
        "pressed_height": float(run.dataset["frame_height"].values[frame]),
        "pressed_force": _interpolate_scalar_at(run, "piston_force", at),
        "greatest": float(force.max()),
        **_run_cost_and_versions(run),
    }


@keep_measure_name("validation.measured_quantities.records:damper_record, 2")
def measure_fall_equilibrium_and_oscillation(run: Trajectory) -> Mapping[str, Any]:
    """Return the fall, the equilibrium, and the oscillation after the lift.

    Returns
    -------
    mapping
        ``rest_height``, ``nudge`` [m]; ``fall`` and ``swing``: ``times`` [s] and ``heights`` [m]
        of the drop and of the motion after the lift; and the cost.
    """
    rest = run.stage("drop").height
    fall, oscillation = (run.piston(name).with_time_from_zero() for name in ("drop", "release"))
    return {
        "rest_height": rest,
        "nudge": float(oscillation.height[0]) - rest,
        "fall": _evenly_sampled_motion(fall.time, fall.height),
        "swing": _evenly_sampled_motion(oscillation.time, oscillation.height),
        **_run_cost_and_versions(run),
    }


def _evenly_sampled_motion(time: np.ndarray, height: np.ndarray) -> dict[str, list[float]]:
    even = np.linspace(0.0, min(SWING_SPAN, float(time[-1])), SWING_SAMPLES)
    return {"times": even.tolist(), "heights": np.interp(even, time, height).tolist()}


def _run_cost_and_versions(run: Trajectory) -> dict[str, Any]:
    from granular.shared.version import toolkit_and_library_versions

    settings = run.settings()
    return {
        "seconds": settings["seconds"],
        "steps": settings["steps"],
        "ledger": settings["ledger_residual"],
        "versions": toolkit_and_library_versions(),
    }


def _rounded_positions(positions: np.ndarray) -> list[list[float]]:
    result: list[list[float]] = np.round(positions, 9).tolist()
    return result


def _nearest_frame_index(run: Trajectory, time: float) -> int:
    return int(np.abs(run.dataset["frame_time"].values - time).argmin())


def _interpolate_scalar_at(run: Trajectory, name: str, time: float) -> float:
    return float(np.interp(time, run.dataset["time"].values, run.dataset[name].values))


def _force_over_stage(run: Trajectory, stage: StageResult) -> list[float]:
    """Return the piston force at equal time intervals, which are equal intervals of the stroke."""
    samples = np.linspace(stage.start, stage.end, STROKE_SAMPLES)
    data = run.dataset
    result = np.interp(samples, data["time"].values, data["piston_force"].values)
    return [float(item) for item in result]
