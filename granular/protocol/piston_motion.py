"""Height of a driven piston, and outer force on a free piston, as functions of time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.kernel_data.state import cubic_spline_value_and_slope
from granular.shared.array_types import Float

STRAIGHT, DESCENT, SINE, TABLE, SPLINE = range(5)
_NONE = np.zeros(2)


class PistonMotion(NamedTuple):
    """Motion of the piston during a stage."""

    free: bool = False  # moved by weight and the grains' force; otherwise along the path
    kind: int = STRAIGHT
    start: float = 0.0  # height at the stage's start [D]
    speed: float = 0.0  # of the straight path [D/tau]
    reach: float = 0.0  # total descent, or amplitude of the sine [D]
    total_duration: float = 1.0  # of the descent [tau]
    steepness: float = 1.0  # exponent of the descent
    omega: float = 0.0  # of the sine, or of the outer force [1/tau]
    push: float = 0.0  # amplitude of the outer force [F*]
    bias: float = 0.0  # mean outer force [F*]
    limit: float = math.inf  # force on the piston that ends the stage [F*]
    times: Float[np.ndarray, "k"] = _NONE  # of the table; for the spline, equidistant knots from 0 [tau]
    heights: Float[np.ndarray, "k"] = _NONE  # [D]; for a spline of the outer force, its values [F*]
    slopes: Float[np.ndarray, "k"] = _NONE  # of the spline [D/tau, F*/tau]


@entry
def driven_height_and_velocity(motion: PistonMotion, time: float) -> tuple[float, float]:
    """Height [D] and velocity [D/tau] of a driven piston; time [tau]."""
    if motion.kind == DESCENT:
        return _exponential_descent_height_and_velocity(motion, time)
    if motion.kind == SINE:
        phase = motion.omega * time
        height = motion.start + motion.reach * math.sin(phase)
        return height, motion.reach * motion.omega * math.cos(phase)
    if motion.kind == TABLE:
        return _interpolate_height_and_velocity(motion.times, motion.heights, time)
    if motion.kind == SPLINE:
        return cubic_spline_value_and_slope(motion.heights, motion.slopes, motion.times[1], time)
    return motion.start + motion.speed * time, motion.speed


@compiled
def _exponential_descent_height_and_velocity(motion: PistonMotion, time: float) -> tuple[float, float]:
    """Return height and velocity for H = H_s - (H_s - H_0) (e^(k s) - 1)/(e^k - 1) with s = t/span."""
    k = motion.steepness
    total = math.expm1(k)
    part = math.expm1(k * time / motion.total_duration)
    speed = -motion.reach * k / motion.total_duration * (part + 1.0) / total
    return motion.start - motion.reach * part / total, speed


@compiled
def _interpolate_height_and_velocity(times: Array, heights: Array, time: float) -> tuple[float, float]:
    """Interpolate linearly in the table; at a tabulated time, the velocity is the slope before this time."""
    k = min(max(int(np.searchsorted(times, time)) - 1, 0), times.size - 2)
    speed = (heights[k + 1] - heights[k]) / (times[k + 1] - times[k])
    return heights[k] + speed * (time - times[k]), speed


def maximum_piston_speed(
    motion: PistonMotion, mass: float, gravity: float, height: float, speed: float
) -> float:
    """Maximum piston speed in a stage [D/tau], given the height [D] and speed of the piston at the start."""
    if motion.free:
        outer = abs(motion.bias) + abs(motion.push)
        if motion.kind == SPLINE:
            outer += float(np.abs(motion.heights).max())
        # Upper bound: the work of weight and maximum outer force over the whole height.
        pull = gravity + outer / mass
        return math.sqrt(speed**2 + 2.0 * pull * max(height, 0.0))
    if motion.kind == DESCENT:
        k = motion.steepness
        return motion.reach * k / motion.total_duration * (1.0 + 1.0 / math.expm1(k))
    if motion.kind == SINE:
        return motion.reach * motion.omega
    if motion.kind == TABLE:
        return float(np.abs(np.diff(motion.heights) / np.diff(motion.times)).max())
    if motion.kind == SPLINE:
        return float(np.abs(motion.slopes).max())
    return abs(motion.speed)


def drive_angular_frequency(motion: PistonMotion) -> float:
    """Angular frequency of the drive, or maximum relative rate of change of the piston's speed [1/tau]."""
    if motion.kind == DESCENT:
        return motion.steepness / motion.total_duration
    if motion.kind == TABLE:
        return 1.0 / float(np.diff(motion.times).min())
    if motion.kind == SPLINE:
        fastest = float(np.abs(motion.slopes).max())
        bend = float(np.abs(np.diff(motion.slopes)).max()) / float(motion.times[1])
        return bend / fastest if fastest > 0.0 else 0.0
    return motion.omega


@compiled
def outer_force_on_piston(motion: PistonMotion, time: float) -> float:
    """Outer force on a free piston [F*]; time [tau]."""
    if motion.kind == SPLINE:
        return cubic_spline_value_and_slope(motion.heights, motion.slopes, motion.times[1], time)[0]
    if motion.push == 0.0:
        return motion.bias
    return motion.bias + motion.push * math.sin(motion.omega * time)
