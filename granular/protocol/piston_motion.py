"""Position of a driven piston, and outer force on a free one, as functions of time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry

if TYPE_CHECKING:
    from jaxtyping import Float

STRAIGHT, DESCENT, SINE, TABLE, SPLINE = range(5)
_NONE = np.zeros(2)


class Motion(NamedTuple):
    """Motion of the piston during a stage."""

    free: bool = False  # under weight and the grains' force; else along the path
    kind: int = STRAIGHT
    start: float = 0.0  # height at the stage's start [D]
    speed: float = 0.0  # of the straight path [D/tau]
    reach: float = 0.0  # lost in the descent, or amplitude of the sine [D]
    total_duration: float = 1.0  # of the descent [tau]
    steepness: float = 1.0  # exponent of the descent
    omega: float = 0.0  # of the sine, or of the outer force [1/tau]
    push: float = 0.0  # amplitude of the outer force [F*]
    bias: float = 0.0  # its mean [F*]
    limit: float = math.inf  # force on the piston that ends the stage [F*]
    times: Float[np.ndarray, "k"] | None = (
        None  # times of the table, or equidistant knots of the spline [tau]
    )
    heights: np.ndarray | None = None  # heights of the table [D]; of a spline the values, then their slopes


@entry
def driven_height_and_velocity(motion: Motion, time: float) -> tuple[float, float]:
    """Height and velocity of a driven piston [D; D/tau]; time [tau]."""
    return _driven_height_and_velocity(motion.times, motion.heights, motion, time)


@compiled
def _driven_height_and_velocity(
    times: Array | None, heights: Array | None, motion: Motion, time: float
) -> tuple[float, float]:
    if motion.kind == DESCENT:
        return _exponential_descent(motion, time)
    if motion.kind == SINE:
        phase = motion.omega * time
        height = motion.start + motion.reach * math.sin(phase)
        return height, motion.reach * motion.omega * math.cos(phase)
    if times is not None and heights is not None:
        if motion.kind == TABLE:
            return _interpolate_linearly(times, heights, time)
        if motion.kind == SPLINE:
            return _evaluate_spline(times, heights, time)
    return motion.start + motion.speed * time, motion.speed


@compiled
def _exponential_descent(motion: Motion, time: float) -> tuple[float, float]:
    """H = H_s - (H_s - H_0) (e^(k s) - 1)/(e^k - 1) with s = t/span."""
    k = motion.steepness
    total = math.expm1(k)
    part = math.expm1(k * time / motion.total_duration)
    speed = -motion.reach * k / motion.total_duration * (part + 1.0) / total
    return motion.start - motion.reach * part / total, speed


@compiled
def _last_row_before(times: Array, time: float) -> int:
    """Last row before a time, by bisection; -1 without one."""
    low, high = 0, times.size
    while low < high:
        middle = (low + high) // 2
        if times[middle] < time:
            low = middle + 1
        else:
            high = middle
    return low - 1


@compiled
def _interpolate_linearly(times: Array, heights: Array, time: float) -> tuple[float, float]:
    """Straight lines from row to row; at a row the slope before it, which a piston released there keeps."""
    k = min(max(_last_row_before(times, time), 0), times.size - 2)
    speed = (heights[k + 1] - heights[k]) / (times[k + 1] - times[k])
    return heights[k] + speed * (time - times[k]), speed


@compiled
def _evaluate_spline(times: Array, heights: Array, time: float) -> tuple[float, float]:
    """Value and slope of the cubic spline; behind its ends what they are."""
    count = times.size
    h = times[1]
    k = min(max(int(time / h), 0), count - 2)
    s = min(max(time / h - k, 0.0), 1.0)
    low, high = heights[k], heights[k + 1]
    rise, left, right = high - low, h * heights[count + k], h * heights[count + k + 1]
    bend, twist = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    return low + s * (left + s * (bend + s * twist)), (left + s * (2.0 * bend + 3.0 * s * twist)) / h


def with_table_arrays(motion: Motion) -> Motion:
    """Give a motion empty arrays: beside tables, all stages of a protocol are one type to the compiler."""
    return motion if motion.times is not None else motion._replace(times=_NONE, heights=_NONE)


def greatest_piston_speed(motion: Motion, mass: float, gravity: float, height: float, speed: float) -> float:
    """Largest piston speed in a stage [D/tau]; mass [m], gravity [D/tau^2], height [D], speed [D/tau]."""
    if motion.free:
        outer = abs(motion.bias) + abs(motion.push)
        if motion.kind == SPLINE:
            times, heights = _table_arrays(motion)
            outer += float(np.abs(heights[: times.size]).max())
        # A bound: at most the energy that weight and the largest outer force give over the whole height.
        pull = gravity + outer / mass
        return math.sqrt(speed**2 + 2.0 * pull * max(height, 0.0))
    if motion.kind == DESCENT:
        k = motion.steepness
        return motion.reach * k / motion.total_duration * (1.0 + 1.0 / math.expm1(k))
    if motion.kind == SINE:
        return motion.reach * motion.omega
    if motion.kind == TABLE:
        times, heights = _table_arrays(motion)
        return float(np.abs(np.diff(heights) / np.diff(times)).max())
    if motion.kind == SPLINE:
        times, heights = _table_arrays(motion)
        return float(np.abs(heights[times.size :]).max())
    return abs(motion.speed)


def _table_arrays(motion: Motion) -> tuple[Array, Array]:
    assert motion.times is not None
    assert motion.heights is not None
    return motion.times, motion.heights


def drive_angular_frequency(motion: Motion) -> float:
    """Angular frequency that the drive has, or the rate at which it changes [1/tau]."""
    if motion.kind == DESCENT:
        return motion.steepness / motion.total_duration
    if motion.kind == TABLE:
        return 1.0 / float(np.diff(_table_arrays(motion)[0]).min())
    if motion.kind == SPLINE:
        times, heights = _table_arrays(motion)
        slopes = heights[times.size :]
        fastest = float(np.abs(slopes).max())
        bend = float(np.abs(np.diff(slopes)).max()) / float(times[1])
        return bend / fastest if fastest > 0.0 else 0.0
    return motion.omega


@compiled
def outer_force_on_piston(motion: Motion, time: float) -> float:
    """Force from outside on a free piston [F*]; time [tau]."""
    return _outer_force_value(motion.times, motion.heights, motion, time)


@compiled
def _outer_force_value(times: Array | None, heights: Array | None, motion: Motion, time: float) -> float:
    if times is not None and heights is not None and motion.kind == SPLINE:
        return _evaluate_spline(times, heights, time)[0]
    if motion.push == 0.0:
        return motion.bias
    return motion.bias + motion.push * math.sin(motion.omega * time)
