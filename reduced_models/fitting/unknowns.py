"""Unknowns of a fit: the parameters of a law, and the initial state."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from reduced_models.laws.law import Law
from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    from jaxtyping import Float

Pairs = Mapping[str, tuple[float, float]]
"""Least and greatest values by names."""

# A factor of e^3 = 20 either way for a logarithm. It keeps open directions from running away; by a sample's
# information it moves nothing that a record tells.
_PRIOR_SPREAD = 3.0


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """A law, and the scales in which the search works."""

    # The search vector holds parameters (logarithms of positive ones, multiples of `units` of the others);
    # height from rest, velocity and hidden states at the start; a sensor's open gain and offset, and its
    # filter's state. Heights count in amplitudes.

    law: Law
    units: tuple[float, ...]  # of the parameters that are no logarithms; 1 of the others
    rest: float  # [m]
    amplitude: float  # [m]
    speed: float  # amplitude times angular frequency [m/s]
    sensor: Sensor | None = None
    signal: float = 1.0  # size of the signal that is compared, in its unit
    observation: str = ""  # of the law, that is compared; empty for the height, or what a sensor makes of it

    @property
    def compares_heights(self) -> bool:
        """True where heights are compared, and no signal."""
        return self.sensor is None and not self.observation

    @property
    def residual_unit(self) -> float:
        """Size that residuals are counted in: that of the signal, or the amplitude [m]."""
        return self.amplitude if self.compares_heights else self.signal

    @property
    def scales(self) -> np.ndarray:
        """Numbers that the compiled residual takes: rest, amplitude, speed, units, sensor."""
        numbers = [self.rest, self.amplitude, self.speed, *self.units]
        if not self.compares_heights:
            sensor = self.sensor or Sensor(gain=1.0, offset=0.0)
            numbers += [self.signal, sensor.derivative_sign * sensor.nominal_gain, sensor.nominal_offset]
        return np.array(numbers)

    @property
    def open_gain_and_offset(self) -> tuple[bool, bool]:
        """Tell whether gain and offset of the sensor are entries of the search vector."""
        if self.sensor is None:
            return False, False
        gain, offset = self.sensor.gain, self.sensor.offset
        return not isinstance(gain, int | float), not isinstance(offset, int | float)

    @property
    def sensor_entry_count(self) -> int:
        """Number of entries that a sensor has: gain, offset, and the filter's state."""
        return sum(self.open_gain_and_offset) + (0 if self.sensor is None else self.sensor.filter_order)

    @property
    def logarithmic_parameters(self) -> tuple[bool, ...]:
        """True for each parameter that is searched for by its logarithm."""
        return tuple(name in self.law.positive for name in self.law.parameters)

    @property
    def prior(self) -> np.ndarray:
        """Prior precision of each entry, in the information of one sample."""
        # The initial height and velocity have none: the first samples tell them.
        hidden = [_PRIOR_SPREAD**-2] * len(self.law.hidden)
        sensor = [_PRIOR_SPREAD**-2] * self.sensor_entry_count
        return np.array([_PRIOR_SPREAD**-2] * len(self.law.parameters) + [0.0, 0.0] + hidden + sensor)

    def physical_values(self, theta: Float[np.ndarray, "p"]) -> Any:
        """Parameters; height [m], velocity [m/s] and hidden states at first."""
        motion = theta[: len(theta) - self.sensor_entry_count]
        return physical_values(motion, self.scales, self.logarithmic_parameters, np)

    def gain_and_offset(self, theta: Float[np.ndarray, "p"]) -> tuple[float, float]:
        """Gain and offset of the sensor by a search vector (p,)."""
        gain, offset, _ = sensor_values(
            theta[len(theta) - self.sensor_entry_count :], self.scales, self.open_gain_and_offset
        )
        assert self.sensor is not None
        return float(gain) * self.sensor.derivative_sign, float(offset)


def theta_bounds(
    unknowns: Unknowns, bounds: Pairs, initial: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest entries (p,) of the search vector, equal where held; initial [m, m/s] by name."""
    edges = np.full((2, len(unknowns.prior)), [[-np.inf], [np.inf]])
    for k, name in enumerate(unknowns.law.parameters):
        if name not in bounds:
            continue
        for side, value in enumerate(bounds[name]):
            if name in unknowns.law.positive:
                edges[side, k] = math.log(value) if value > 0.0 else -np.inf
            else:
                edges[side, k] = value / unknowns.units[k]
    names = ("height", "velocity", *unknowns.law.hidden)
    count = len(unknowns.law.parameters)
    if unknowns.law.prescribed:  # the stroke is no state
        edges[:, count : count + 2] = 0.0
    for k, name in enumerate(names, count):
        if name in initial:
            value = initial[name]
            if name == "height":
                value = (value - unknowns.rest) / unknowns.amplitude
            elif name == "velocity":
                value = value / unknowns.speed
            edges[:, k] = value
    if unknowns.sensor is not None:
        _bound_sensor(unknowns, unknowns.sensor, edges)
    return edges[0], edges[1]


def _bound_sensor(unknowns: Unknowns, sensor: Sensor, edges: np.ndarray) -> None:
    """Set the edges (2, p) of a sensor's gain and offset that lie between two numbers."""
    k = edges.shape[1] - unknowns.sensor_entry_count
    settings = (
        (sensor.gain, 0.0, sensor.nominal_gain),
        (sensor.offset, sensor.nominal_offset, unknowns.signal),
    )
    for (setting, middle, unit), is_open in zip(settings, unknowns.open_gain_and_offset, strict=True):
        if isinstance(setting, tuple):
            edges[:, k] = sorted((value - middle) / unit for value in setting)
        k += is_open


def physical_values(theta: Any, scales: Any, logarithmic: tuple[bool, ...], np_: Any) -> Any:
    """Parameters; height [m], velocity [m/s] and hidden states at first, of vectors (p, ...)."""
    rest, amplitude, speed = (scales[k] for k in range(3))
    count = len(logarithmic)
    values = tuple(
        np_.exp(theta[k]) if log else scales[3 + k] * theta[k] for k, log in enumerate(logarithmic)
    )
    return values, rest + amplitude * theta[count], speed * theta[count + 1], tuple(theta[count + 2 :])


def sensor_values(entries: Any, scales: Any, is_open: tuple[bool, bool]) -> tuple[Any, Any, Any]:
    """Gain with its sign, offset, and the filter's state at the start, from a sensor's entries."""
    signal, gain, offset = scales[-3], scales[-2], scales[-1]
    if is_open[0]:
        gain, entries = gain * entries[0], entries[1:]
    if is_open[1]:
        offset, entries = offset + signal * entries[0], entries[1:]
    return gain, offset, entries * (signal / scales[-2])
