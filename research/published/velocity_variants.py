"""De Paula's friction in an independent loop, with two variants of its velocity.

[D, eq. 2.17] computes the velocity at a step from the position after this step, which itself depends on
friction. The thesis does not specify the velocity in the friction law. Two velocities are available in a
position-Verlet loop: the last difference, (x_n - x_(n-1))/h, and [D, eq. 2.17] for the previous step,
(x_n - x_(n-2))/2h. With the last difference, a grain whose velocity alternates in sign creeps with its
acceleration times the step. With the toolkit's two kicks per step it creeps at half this velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from research.published.protocols import PUBLISHED
from research.published.series import equal_grain_series
from research.published.start_and_creep import GRID, grid_height_changes, regularised_friction_settings
from validation.measured_quantities import compression_duration

TILT = 0.0126585
"""N_i = K sum_j r_ij^-3 of 6 mm grains [D, eq. 2.15]."""
STATIC, DYNAMIC = 0.6, 0.45
LATE_HASTE = 8.0
"""Speed of the cycle and length of the step over de Paula's, as in `start_and_creep`."""
LATE_SEEDS = (1,)
RELAXATION = 5.0
"""Times in units of T."""


@numba.njit(cache=True, fastmath=True)
def _fill_forces_and_inverse_cube_sums(
    x: np.ndarray, y: np.ndarray, width: float, piston: float, gravity: float, force: np.ndarray
) -> None:
    """Return magnetic force plus weight, and sum of r^-3, of every grain, in natural units."""
    force[0, :] = 0.5 * (x**-3.5 - (width - x) ** -3.5)
    force[1, :] = 0.5 * (y**-3.5 - (piston - y) ** -3.5) - gravity
    force[2, :] = 0.0
    for i in range(x.size):
        fx, fy, load = 0.0, 0.0, 0.0
        for j in range(i):
            dx, dy = x[i] - x[j], y[i] - y[j]
            square = dx * dx + dy * dy
            cube = 1.0 / (square * math.sqrt(square))
            ratio = 0.75 * cube / square
            fx += ratio * dx
            fy += ratio * dy
            load += cube
            force[0, j] -= ratio * dx
            force[1, j] -= ratio * dy
            force[2, j] += cube
        force[0, i] += fx
        force[1, i] += fy
        force[2, i] += load


@numba.njit(cache=True, fastmath=True)
def _half_mean_distance(x: np.ndarray, y: np.ndarray) -> float:
    total = 0.0
    for i in range(x.size):
        for j in range(i):
            total += math.hypot(x[i] - x[j], y[i] - y[j])
    return total / (x.size * (x.size - 1))


@numba.njit(cache=True, fastmath=True)
def _piston_height_at(time: float, heights: tuple[float, float, float]) -> float:
    """Return the height of the piston at a time in T after the start of the relaxation [D, 2.3.2]."""
    top, start, end = heights
    if time < RELAXATION:
        bottom = math.exp(-RELAXATION)
        return top - (top - start) * (math.exp(time - RELAXATION) - bottom) / (1.0 - bottom)
    if time < RELAXATION + 1.0:
        return start - (start - end) * (time - RELAXATION)
    return min(start, end + (start - end) * (time - RELAXATION - 1.0))


@numba.njit(cache=True, fastmath=True)
def _half_mean_distances_at_start_and_end(
    positions: np.ndarray,
    velocities: np.ndarray,
    width: float,
    gravity: float,
    heights: tuple[float, float, float],
    period: float,
    step: float,
    threshold: float,
    late: bool,
) -> tuple[float, float]:
    """Return half the mean distance before the compression and at t = 3 T."""
    now = positions.copy()
    before = now - step * velocities
    earlier = before - step * velocities
    force = np.zeros((3, now.shape[1]))
    first, last = round(RELAXATION * period / step), round((RELAXATION + 3.0) * period / step)
    start = 0.0
    for k in range(last):
        if k == first:
            start = _half_mean_distance(now[0], now[1])
        height = _piston_height_at(k * step / period, heights)
        _fill_forces_and_inverse_cube_sums(now[0], now[1], width, height, gravity, force)
        for i in range(now.shape[1]):
            if late:
                vx = 0.5 * (now[0, i] - earlier[0, i]) / step
                vy = 0.5 * (now[1, i] - earlier[1, i]) / step
            else:
                vx, vy = (now[0, i] - before[0, i]) / step, (now[1, i] - before[1, i]) / step
            load, fx, fy = TILT * force[2, i], force[0, i], force[1, i]
            speed = math.sqrt(vx * vx + vy * vy)
            if math.sqrt(fx * fx + fy * fy) <= STATIC * load and speed < threshold:
                fx, fy = 0.0, 0.0
            else:
                brake = DYNAMIC * load / (speed + threshold)
                fx, fy = fx - brake * vx, fy - brake * vy
            for axis, acceleration in ((0, fx), (1, fy)):
                after = 2.0 * now[axis, i] - before[axis, i] + step * step * acceleration
                earlier[axis, i] = before[axis, i]
                before[axis, i] = now[axis, i]
                now[axis, i] = after
    return start, _half_mean_distance(now[0], now[1])


def half_mean_distances_at_start_and_end(scene: Scene, step: float, *, late: bool) -> tuple[float, float]:
    """Return half the mean distance at start and end of a bed's cycle [D].

    Parameters
    ----------
    scene : Scene
        One of `research.published.series.equal_grain_series`, with the regularised friction.
    step : float
        Time step [s].
    late : bool
        Use [D, eq. 2.17] of the previous step in the friction, instead of the last difference.
    """
    friction, piston = scene.effects.friction, scene.piston
    assert piston is not None
    assert friction is not None
    scales, stages = Scales.from_grains(scene.grains), scene.protocol
    heights = [stages[0].prescribed_final_height(), stages[1].prescribed_final_height()]
    assert heights[0] is not None
    assert heights[1] is not None
    period = stages[1].maximum_duration(heights[0])
    assert period is not None
    position, velocity = scene.initial_positions_and_velocities()
    start, end = _half_mean_distances_at_start_and_end(
        np.ascontiguousarray(position.T / scales.length),
        np.ascontiguousarray(velocity.T / scales.velocity),
        scene.cell.width / scales.length,
        9.8 / scales.acceleration,
        (piston.height / scales.length, heights[0] / scales.length, heights[1] / scales.length),
        period / scales.time,
        step / scales.time,
        friction.threshold / scales.velocity,
        late,
    )
    return float(start), float(end)


def half_mean_distances_with_both_causes(count: int, seed: int) -> tuple[float, float]:
    """Return half the mean distance at start and end of a bed with both causes [D].

    Friction uses [D, eq. 2.17] of the previous step, in a cycle `LATE_HASTE` times faster.
    """
    period = compression_duration(count, PUBLISHED.speed)
    bed = equal_grain_series(
        "",
        count,
        PUBLISHED,
        speed=LATE_HASTE * PUBLISHED.speed,
        effects__friction=regularised_friction_settings(period),
        **grid_height_changes(count, GRID),
    )
    return half_mean_distances_at_start_and_end(bed.scene(seed), LATE_HASTE * 1e-6 * period, late=True)


def half_mean_distances_of_beds_with_both_causes(sizes: Sequence[int]) -> dict[str, float]:
    """Return starts and ends of `half_mean_distances_with_both_causes` by bed and seed."""
    distances = {}
    for count in sizes:
        for seed in LATE_SEEDS:
            distances[f"start {count}, {seed}"], distances[f"end {count}, {seed}"] = (
                half_mean_distances_with_both_causes(count, seed)
            )
    return distances
