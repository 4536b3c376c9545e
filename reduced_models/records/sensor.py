"""Sensors: the quantity of a motion that is measured, and the resulting signal."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

import numpy as np

from granular.records.headings import BASE_ACCELERATION, BASE_HEIGHT
from granular.records.integration import integrate_without_drift
from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError, RecordError, quote
from reduced_models.records.derivatives import derivatives

SensorQuantity = Literal["height", "velocity", "acceleration", "force", "base_force"]
Columns = Mapping[str, np.ndarray]
Setting = float | tuple[float, float] | Literal["free"]
"""A known number, a pair of bounds, or "free" for a number to be fitted."""

_DERIVATIVES: dict[str, int] = {"height": 0, "velocity": 1, "acceleration": 2, "force": 2, "base_force": 2}
_SETTINGS = ("gain", "offset", "low_pass", "high_pass", "damping_ratio", "absolute", "column")
_MAXIMUM_ITEMS = 20  # maximum number of words that are read in a line of text


@dataclasses.dataclass(frozen=True)
class Sensor:
    """A sensor with the signal gain * quantity + offset, which may pass through a filter.

    Attributes
    ----------
    quantity : str
        ``"height"`` [m], ``"velocity"`` [m/s] or ``"acceleration"`` [m/s^2] of the coordinate;
        ``"base_force"``, the reaction of the mass on the base, for which the gain is the mass [kg];
        or ``"force"``, the force along a prescribed stroke or, in a record without heights, the
        force that accelerates the mass.
    gain, offset : float, (float, float) or "free", optional
        A known number, lower and upper bounds, or ``"free"`` for a fitted value. The gain has the unit
        of the signal divided by the unit of the quantity; it is not 0, and its bounds have the same
        sign. The offset has the unit of the signal. By default the gain is 1 (free for a force) and
        the offset is free (0 for a height).
    low_pass, high_pass : float, optional
        Corner frequency of the filter, above 0 [Hz]; give one of the two at most. A geophone is a
        velocity sensor with a high pass.
    damping_ratio : float, optional
        Damping ratio of a second-order filter, above 0; if it is not given, the filter is of first
        order.
    absolute : bool
        Whether the sensor measures in the laboratory frame, including the motion of the base (column
        ``base_height`` or ``base_acceleration``).
    column : str, optional
        Column of the signal; by default the column with the quantity's name.

    Raises
    ------
    InputError
        If the quantity is unknown, gain or offset is not a finite number, an increasing pair or
        ``"free"``, a number is out of its range, two filters are given, or a damping ratio is given
        without a filter.

    Examples
    --------
    >>> from reduced_models import Sensor
    >>> geophone = Sensor("velocity", gain="free", high_pass=4.5, damping_ratio=0.7)
    """

    quantity: SensorQuantity = "acceleration"
    gain: Setting | None = None
    offset: Setting | None = None
    low_pass: float | None = None
    high_pass: float | None = None
    damping_ratio: float | None = None
    absolute: bool = False
    column: str | None = None

    def __post_init__(self) -> None:
        if self.quantity not in _DERIVATIVES:
            known = ", ".join(map(repr, get_args(SensorQuantity)))
            raise InputError(
                f"measured = {quote(self.quantity)} is unknown; give one of {known}, or a Sensor"
            )
        is_force = self.quantity in ("force", "base_force")
        if self.gain is None:
            object.__setattr__(self, "gain", "free" if is_force else 1.0)
        if self.offset is None:
            object.__setattr__(self, "offset", 0.0 if self.quantity == "height" else "free")
        _check_setting("gain", self.gain)
        _check_setting("offset", self.offset)
        if not self.nominal_gain:
            raise InputError("the gain of a sensor is 0, so the sensor has no signal; give another gain")
        if self.low_pass is not None and self.high_pass is not None:
            raise InputError("a sensor can have only one filter; give low_pass or high_pass, not both")
        for name in ("low_pass", "high_pass", "damping_ratio"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0.0 < value < math.inf):
                raise InputError(f"{name} = {quote(value)}; give a number above 0")
        if self.damping_ratio is not None and self.corner_frequency is None:
            raise InputError("damping_ratio is given without a filter; give low_pass or high_pass too")

    def __str__(self) -> str:
        texts = [f"{'absolute ' * self.absolute}{self.quantity.replace('_', ' ')}"]
        for name, value, plain in (("gain", self.gain, 1.0), ("offset", self.offset, 0.0)):
            if value != plain:
                texts.append(f"{name} {value:.5g}" if isinstance(value, float) else name)
        if self.corner_frequency is not None:
            kind = "low" if self.low_pass is not None else "high"
            texts.append(f"{kind} pass of {self.corner_frequency:g} Hz")
        return ", ".join(texts)

    @property
    def derivative_order(self) -> int:
        """Order of the coordinate's time derivative that is measured: 0, 1 or 2 (2 for forces)."""
        return _DERIVATIVES[self.quantity]

    @property
    def derivative_sign_in_signal(self) -> float:
        """Sign of the derivative in the measured quantity: -1 for a force on the base, otherwise 1."""
        return -1.0 if self.quantity == "base_force" else 1.0

    @property
    def corner_frequency(self) -> float | None:
        """Corner frequency of the sensor's low pass or high pass [Hz]; None without a filter."""
        return self.low_pass or self.high_pass

    @property
    def filter_order(self) -> int:
        """Order of the sensor's filter, 1 or 2; 0 for none."""
        return 0 if self.corner_frequency is None else 1 if self.damping_ratio is None else 2

    @property
    def nominal_gain(self) -> float:
        """Start value of the gain (unit of the signal divided by unit of the quantity).

        It is the given number, the middle of the bounds, or 1 if the gain is free.
        """
        return _nominal_value(self.gain, 1.0)

    @property
    def nominal_offset(self) -> float:
        """Start value of the offset in the signal's unit: given value, middle of its bounds, or 0 if free."""
        return _nominal_value(self.offset, 0.0)

    def signal(self, columns: Columns) -> np.ndarray:
        """Return the signal of this sensor from the columns of a record.

        Parameters
        ----------
        columns : mapping of str to float64 (n,)
            Columns of the record, in SI units or the unit of the sensor.

        Returns
        -------
        float64 (n,)
            Column with the name ``column`` or, if that is not given, with the name of the quantity.

        Raises
        ------
        RecordError
            If the record has no such column.
        """
        name = self.column or self.quantity
        if name not in columns:
            available = ", ".join(map(repr, columns))
            raise RecordError(
                f"measured = {self.quantity!r} needs the column {quote(name)}, but the record has "
                f"{available}; add the column, or give the name of another: Sensor(..., column=...)"
            )
        return columns[name]

    def approximate_heights(self, columns: Columns, *, about_rest: bool) -> np.ndarray:
        """Return the heights of a record or, if it has none, heights integrated from the signal.

        The signal is converted with the nominal gain and offset, without regard to the filter, and
        integrated by `granular.records.integration.integrate_without_drift`.

        Parameters
        ----------
        columns : mapping of str to float64 (n,)
            Columns of a `PistonRecord` of two samples or more, in SI units, with ``time``.
        about_rest : bool
            Whether the record's heights are measured from the mean of their last third.

        Returns
        -------
        float64 (n,)
            Heights [m]. Heights integrated from a signal vary about zero even if ``about_rest`` is False.

        Raises
        ------
        RecordError
            If the record has neither heights nor the sensor's signal, or lacks the motion of the base that an
            absolute sensor needs, or has a base height of fewer than 20 samples.
        """
        if "height" in columns:
            height = columns["height"]
            return height - (height[-len(height) // 3 :].mean() if about_rest else 0.0)
        values = (self.signal(columns) - self.nominal_offset) / (
            self.derivative_sign_in_signal * self.nominal_gain
        )
        values = values - self.base_motion(columns)
        return integrate_without_drift(columns["time"], values, self.derivative_order)

    def signal_deviations(self, deviations: Columns) -> dict[str, np.ndarray]:
        """Replace the deviations of the height by the deviations of the signal.

        Parameters
        ----------
        deviations : mapping of str to float64 (k, n)
            Change of each column due to one standard deviation of each calibration constant, in the
            column's unit.

        Returns
        -------
        dict of str to float64 (k, n)
            The same deviations, but ``height`` has the deviations of the signal.
        """
        result = {name: values for name, values in deviations.items() if name != "height"}
        rows = deviations.get(self.column or self.quantity)
        result.pop(self.column or self.quantity, None)
        return result if rows is None else result | {"height": rows}

    def deviations_with_open_gain(self, columns: Columns, deviations: Columns) -> dict[str, np.ndarray]:
        """Add the uncertainty of a gain between two bounds to the deviations of a calibration.

        The gain is assumed to be uniformly distributed between its bounds; its standard deviation is the
        distance between the bounds divided by the square root of 12 (JCGM 100:2008, 4.3.7). The mean of the
        signal is subtracted.

        Parameters
        ----------
        columns : mapping of str to float64 (n,)
            Columns of the record, in SI units.
        deviations : mapping of str to float64 (k, n)
            Change of each column due to one standard deviation of each calibration constant, in the
            column's unit.

        Returns
        -------
        dict of str to float64 (k or k + 1, n)
            The same deviations; if the gain has bounds, the signal's column has one more row, in its unit.

        Raises
        ------
        RecordError
            If the gain has bounds, and the record lacks the signal's column.
        """
        result = dict(deviations)
        if isinstance(self.gain, tuple):
            name, signal = self.column or self.quantity, self.signal(columns)
            spread = (self.gain[1] - self.gain[0]) / math.sqrt(12.0) / self.nominal_gain
            rows = [*deviations.get(name, ()), spread * (signal - signal.mean())]
            result[name] = np.array(rows)
        return result

    def base_motion(self, columns: Columns) -> np.ndarray:
        """Return the motion of the base that the signal includes; zero if the sensor is not absolute.

        Parameters
        ----------
        columns : mapping of str to float64 (n,)
            Columns of a `PistonRecord`, in SI units: ``time``, and ``base_height`` or, for an
            acceleration or a force, ``base_acceleration``, which takes precedence.

        Returns
        -------
        float64 (n,)
            Height [m], velocity [m/s] or acceleration [m/s^2] of the base, according to
            `derivative_order`; if needed, differentiated from a smoothed base height
            (`reduced_models.records.derivatives.derivatives`).

        Raises
        ------
        RecordError
            If the sensor is absolute and the record has no such column of the base, or the base height is not
            finite, differs in shape from the times, or has fewer than 20 samples.
        """
        if not self.absolute:
            return np.zeros(len(columns["time"]))
        if self.derivative_order == 2 and BASE_ACCELERATION in columns:
            return columns[BASE_ACCELERATION]
        if BASE_HEIGHT in columns:
            base = derivatives(PistonRecord(columns["time"], columns[BASE_HEIGHT]))
            return (base.height, base.velocity, base.acceleration)[self.derivative_order]
        wanted = f"{BASE_ACCELERATION} or {BASE_HEIGHT}" if self.derivative_order == 2 else BASE_HEIGHT
        raise RecordError(
            f"an absolute {self.quantity} needs the motion of the base, but the record has no "
            f"column {wanted}; add the column, or use a sensor relative to the base (absolute=False)"
        )


def sensor_report_lines(sensor: Sensor | None, undetermined: Iterable[str]) -> list[str]:
    """Describe the measured signal, and name the quantities that it does not determine."""
    if sensor is None:
        return []
    texts = {"level": "the equilibrium height", "size": "the amplitude of the motion"}
    names = ", ".join(texts.get(name, name) for name in undetermined)
    return [f"  measured: {sensor}"] + [f"  not determined by the signal: {names}"] * bool(names)


def parse_sensor(text: str) -> Sensor:
    """Make a sensor from a line of text: a quantity followed by settings."""
    quantity, *items = text.split()[:_MAXIMUM_ITEMS] or [""]
    given: dict[str, Any] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if name not in _SETTINGS or bool(equals) == (name == "absolute"):
            raise InputError(
                f"{quote(item)} is not a setting of a sensor; write a quantity and any of "
                f"{', '.join(_SETTINGS)}, as in 'velocity gain=free high_pass=4.5'"
            )
        given[name] = value if name == "column" else not equals or _parse_setting(name, value)
    return Sensor(quantity, **given)  # type: ignore[arg-type]  # checked there


def sensor_unless_height(measured: str | Sensor) -> Sensor | None:
    """Return the sensor that is given or named; None if the height itself is measured."""
    sensor = measured if isinstance(measured, Sensor) else Sensor(measured)  # type: ignore[arg-type]  # checked there
    return None if sensor == Sensor("height") else sensor


def _check_setting(name: str, value: object) -> None:
    numbers = value if isinstance(value, tuple) else (value,)
    sound = all(isinstance(item, int | float) and math.isfinite(item) for item in numbers)
    if value == "free" or (sound and len(numbers) == 1):
        return
    if not sound or len(numbers) != 2 or not numbers[0] < numbers[1]:
        raise InputError(f"{name} = {quote(value)}; give a number, a lower and an upper bound, or 'free'")
    if name == "gain" and numbers[0] * numbers[1] <= 0.0:
        raise InputError(
            f"gain = {quote(value)}, but its sign must be known; give two bounds above 0, or two below 0"
        )


def _parse_setting(name: str, text: str) -> Setting:
    if text == "free":
        return "free"
    try:
        numbers = tuple(float(part) for part in text.split(":"))
    except ValueError:
        numbers = ()
    if not 1 <= len(numbers) <= 1 + (name in ("gain", "offset")):
        raise InputError(f"{name}={quote(text)}; give a number, LOW:HIGH or free, in SI units")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def _nominal_value(setting: Setting | None, free: float) -> float:
    if isinstance(setting, tuple):
        return 0.5 * (setting[0] + setting[1])
    return free if setting is None or isinstance(setting, str) else float(setting)


def sensor_of_column(name: str) -> Sensor:
    """Return a sensor that reads a given column, with gain 1 and offset 0."""
    quantity: Any = name if name in get_args(SensorQuantity) else "height"
    return Sensor(quantity, gain=1.0, offset=0.0, column=name)


def motion_signal(
    sensor: Sensor,
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    velocity: Float[np.ndarray, "n"],
    base: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n"]:
    """Return a sensor's signal for a motion in SI units, with the filter initially in its steady state."""
    from scipy.interpolate import CubicSpline

    quantity = (height, velocity)[min(sensor.derivative_order, 1)]
    if sensor.derivative_order == 2:
        quantity = CubicSpline(time, quantity).derivative()(time)
    filtered = filter_by_sensor(sensor, time, sensor.derivative_sign_in_signal * quantity + base)
    return sensor.nominal_gain * filtered + sensor.nominal_offset


def filter_by_sensor(
    sensor: Sensor, time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Pass values through a sensor's filter, in steady state at the first value; ``time`` is in s."""
    from scipy.signal import StateSpace, lsim

    if not sensor.filter_order or not values.any():
        return values
    states, inputs, output, through = continuous_sensor_filter_matrices(sensor, 1.0)
    start = -np.linalg.solve(states, inputs[:, 0]) * values[0]
    even = np.linspace(time[0], time[-1], len(time))
    system = StateSpace(states, inputs, output[None], np.array([[through]]))
    result = lsim(system, np.interp(even, time, values), even - even[0], start)[1]
    return np.asarray(np.interp(time, even, result))


def continuous_sensor_filter_matrices(
    sensor: Sensor, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """State-space matrices of the filter, x' = A x + b u, y = c x + d u; the unit of time is ``step``."""
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
