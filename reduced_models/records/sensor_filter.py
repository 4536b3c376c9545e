"""Signal of a sensor by a motion that is known, and its filter as matrices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    from jaxtyping import Float


def motion_signal(
    sensor: Sensor,
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    velocity: Float[np.ndarray, "n"],
    base: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n"]:
    """Signal of a motion (time [s], height [m], velocity [m/s]) and its base, behind a settled filter."""
    from scipy.interpolate import CubicSpline

    quantity = (height, velocity)[min(sensor.derivative_order, 1)]
    if sensor.derivative_order == 2:
        quantity = CubicSpline(time, quantity).derivative()(time)
    seen = filter_by_sensor(sensor, time, sensor.derivative_sign * quantity + base)
    return sensor.nominal_gain * seen + sensor.nominal_offset


def filter_by_sensor(
    sensor: Sensor, time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Pass values through a sensor's filter that has settled at the first of them; time [s]."""
    from scipy.signal import StateSpace, lsim

    if not sensor.filter_order or not values.any():
        return values
    states, inputs, output, through = filter_matrices(sensor, 1.0)
    start = -np.linalg.solve(states, inputs[:, 0]) * values[0]
    even = np.linspace(time[0], time[-1], len(time))
    system = StateSpace(states, inputs, output[None], np.array([[through]]))
    result = lsim(system, np.interp(even, time, values), even - even[0], start)[1]
    return np.asarray(np.interp(time, even, result))


def filter_matrices(sensor: Sensor, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Matrices of x' = A x + b u, y = c x + d u, with time in steps."""
    if not sensor.filter_order:
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros(0), 1.0
    assert sensor.corner_frequency is not None
    omega, low = 2.0 * math.pi * sensor.corner_frequency * step, sensor.low_pass is not None
    if sensor.filter_order == 1:
        output = np.array([1.0 if low else -1.0])
        return np.array([[-omega]]), np.array([[omega]]), output, float(not low)
    assert sensor.damping_ratio is not None
    ratio = 2.0 * sensor.damping_ratio
    output = np.array([1.0, 0.0] if low else [-1.0, -ratio])
    matrix = omega * np.array([[0.0, 1.0], [-1.0, -ratio]])
    return matrix, np.array([[0.0], [omega]]), output, float(not low)
