"""Excitation of a host (the structure that carries the damper): a force or a base motion in time."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.compiled import compiled
from granular.kernel_data.state import cubic_spline_value_and_slope
from granular.schema.field_kinds import FieldError, add_key_to_errors
from granular.schema.natural_units import Scales
from granular.schema.sections import (
    Section,
    choice_field,
    integer_field,
    quantity,
    quantity_list_field,
    text_field,
)
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, quote

SINE, SWEEP, IMPULSE, TABLE = range(4)

# The cubic interpolation error of a sine is then (2 pi/24)^4/384 = 1.2e-5 of its amplitude.
KNOTS_PER_PERIOD = 24
"""Number of spline knots per period, at the highest frequency of the noise."""
MAXIMUM_LINES, MAXIMUM_KNOTS = 2048, 2**20
MINIMUM_ROWS = 4
"""Minimum number of rows of a table."""
_KEYS = {
    "sine": ("frequency",),
    "sweep": ("frequency", "to", "duration"),
    "impulse": ("duration",),
    "noise": ("frequency", "to", "duration", "seed"),
    "table": ("times", "values"),
    "record": ("file",),
}
"""Keys of each kind of excitation, in addition to the keys that all kinds have."""
_AMPLITUDES = ("force", "acceleration", "displacement")


class HostExcitation(Section):
    """A force on a body of the host, or a motion of the base; both are positive upwards.

    Exactly one of ``force``, ``acceleration`` and ``displacement`` is given. This value is the amplitude of a
    sine or a sweep, the peak of an impulse, or the rms value of noise. The values of a table or a record are
    multiplied by this value.

    Attributes
    ----------
    kind : str
        ``"sine"``; ``"sweep"``, a sine whose frequency increases exponentially; ``"impulse"``, half a period
        of a sine; ``"noise"``, white in a frequency band; ``"table"``; or ``"record"``, a table in a file
        with a time and a value in each line. The file is read like a laboratory record: columns with a unit
        after their name are converted to N or m/s^2.
    force : float or None
        Force on the body [N].
    acceleration : float or None
        Amplitude of the base's acceleration [m/s^2].
    displacement : float or None
        Amplitude of the base's displacement [m], for a sine or a sweep.
    frequency : float or None
        Frequency of a sine, or lowest frequency of a sweep or of noise [Hz].
    to : float or None
        Highest frequency of a sweep or of noise [Hz].
    start : float
        Start time, from the start of the run [s].
    duration : float or None
        Duration of a sweep, an impulse or noise [s].
    seed : int
        Seed of the phases of the noise.
    times : tuple of float
        Times of a table [s], increasing, counted from ``start``.
    values : tuple of float
        Values of a table at these times, each multiplied by the force or acceleration.
    file : str or None
        File of a record, which is stored as a table in the scene.
    """

    kind: str = choice_field("sine", "sweep", "impulse", "noise", "table", "record", default="sine")
    force: float | None = quantity("N", default=None, optional=True)
    acceleration: float | None = quantity("m/s^2", default=None, optional=True)
    displacement: float | None = quantity("m", default=None, optional=True)
    frequency: float | None = quantity("Hz", above=0.0, default=None, optional=True)
    to: float | None = quantity("Hz", above=0.0, default=None, optional=True)
    start: float = quantity("s", default=0.0, least=0.0)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    seed: int = integer_field(default=1)
    times: tuple[float, ...] = quantity_list_field("s", default=(), least=0.0)
    values: tuple[float, ...] = quantity_list_field("1", default=())
    file: str | None = text_field(default=None, optional=True)

    def validate(self) -> None:
        """Check that exactly one amplitude and all keys of the kind are given; read the file of a record."""
        given = [name for name in _AMPLITUDES if getattr(self, name) is not None]
        if len(given) != 1:
            raise FieldError(f"{len(given)} of {', '.join(_AMPLITUDES)} are given; give exactly one")
        self._check_keys_of_kind()
        if self.displacement is not None and self.kind not in ("sine", "sweep"):
            raise FieldError(
                f"only a sine or a sweep has a displacement; for {quote(self.kind)} use acceleration",
                "displacement",
            )
        if self.kind in ("sweep", "noise") and not (self.to or 0.0) > (self.frequency or 0.0):
            raise FieldError(f"{self.to:g} Hz must be above {self.frequency:g} Hz", "to")
        if self.kind == "record":
            self._load_record_as_table()
        if self.kind == "table":
            self._check_table()
        if self.kind == "noise":
            _noise_knot_count(self)

    def _check_keys_of_kind(self) -> None:
        """Check that all keys of the given kind of excitation, and no keys of other kinds, are given."""
        keys_of_kind = _KEYS[self.kind]
        for field in dataclasses.fields(self):
            given = getattr(self, field.name) != field.default
            if field.name in keys_of_kind and getattr(self, field.name) is None:
                raise FieldError(f"must be given for {quote(self.kind)}", field.name)
            if given and field.name not in (*keys_of_kind, *_AMPLITUDES, "kind", "start"):
                raise FieldError(
                    f"has no effect for {quote(self.kind)}, whose keys are "
                    f"{', '.join(keys_of_kind)} and start; remove it",
                    field.name,
                )

    def _load_record_as_table(self) -> None:
        from granular.records.formats import read_times_and_values

        unit = "N" if self.acceleration is None else "m/s^2"
        with add_key_to_errors("file", errors=RecordError):
            times, values = read_times_and_values(Path(str(self.file)), unit)
        if len(times) < MINIMUM_ROWS:
            raise FieldError(
                f"{quote(self.file)} has {len(times)} rows with numbers; {MINIMUM_ROWS} or more are needed",
                "file",
            )
        table = {"times": tuple((times - times[0]).tolist()), "values": tuple(values.tolist())}
        for name, value in {"kind": "table", "file": None, **table}.items():
            object.__setattr__(self, name, value)

    def _check_table(self) -> None:
        if len(self.times) != len(self.values):
            raise FieldError(
                f"has {len(self.values)} numbers for {len(self.times)} times; give one for each", "values"
            )
        if len(self.times) < MINIMUM_ROWS or (np.diff(self.times) <= 0.0).any():
            raise FieldError("are fewer than 4, or not increasing; give 4 or more increasing values", "times")
        _resampled_table_point_count(self)

    @property
    def is_base_motion(self) -> bool:
        """True if the base moves; otherwise a force acts."""
        return self.force is None

    def highest_frequency(self) -> float:
        """Highest frequency that the time step must resolve [Hz]."""
        if self.kind == "table":
            # Ten rows per period: with fewer, cubic interpolation does not resolve a sine.
            return 0.1 / float(np.diff(self.times).min())
        if self.kind == "impulse":
            # A half sine of this duration is half a period.
            return 0.5 / (self.duration or 1.0)
        return self.to or self.frequency or 0.0

    def make_kernel_law(self, scales: Scales) -> ExcitationLaw:
        """Make the excitation for the compiled loop, in natural units."""
        tau = scales.time
        kind = {"sine": SINE, "sweep": SWEEP, "impulse": IMPULSE}.get(self.kind, TABLE)
        size, is_displacement = self._natural_amplitude_and_is_displacement(scales)
        start, duration = self.start, math.inf if self.duration is None else self.duration
        times, values, slopes = np.zeros(2), np.zeros(2), np.zeros(2)
        if kind == TABLE:
            times, values, slopes = (
                _noise_knots_from_random_phases(self)
                if self.kind == "noise"
                else _spline_knots_through_table(self)
            )
            start, duration = start + times[0], times[-1] - times[0]
            times = times - times[0]
        return ExcitationLaw(
            kind=kind,
            moves_base=self.is_base_motion,
            size=size,
            is_displacement=is_displacement,
            omega=math.tau * (self.frequency or 0.0) * tau,
            ratio=math.log(self.to / self.frequency) if self.to and self.frequency else 0.0,
            start=start / tau,
            duration=math.inf if kind == SINE else duration / tau,
            times=times / tau,
            values=values,
            slopes=slopes * tau,
        )

    def _natural_amplitude_and_is_displacement(self, scales: Scales) -> tuple[float, bool]:
        if self.force is not None:
            return self.force / scales.force, False
        if self.acceleration is not None:
            return self.acceleration / scales.acceleration, False
        return (self.displacement or 0.0) / scales.length, True


class ExcitationLaw(NamedTuple):
    """Excitation in natural units, for the compiled loop."""

    kind: int
    moves_base: bool  # whether it is an acceleration of the base [D/tau^2]; otherwise a force [F*]
    size: float  # amplitude [F*, D/tau^2], or [D] with ``is_displacement``
    is_displacement: bool  # whether ``size`` is the amplitude of a displacement [D]
    omega: float  # first angular frequency [1/tau]
    ratio: float  # log(last frequency/first)
    start: float  # [tau]
    duration: float  # [tau]
    times: Float[np.ndarray, "k"]  # of a table [tau], equidistant; cubic between
    values: Float[np.ndarray, "k"]  # divided by ``size``
    slopes: Float[np.ndarray, "k"]  # of the values [1/tau]


@compiled
def excitation_force_or_acceleration(drive: ExcitationLaw, time: float) -> float:
    """Force on the host [F*], or acceleration of the base [D/tau^2], at a time [tau]."""
    t = time - drive.start
    return _excitation_at_time(drive, t) if 0.0 <= t <= drive.duration else 0.0


@compiled
def excitation_during_kick(drive: ExcitationLaw, time: float, dt: float, opens_step: bool) -> float:
    """Drive [F* or D/tau^2] in a kick that starts at ``time`` (if it opens a step) or ends at ``time``."""
    t = time - drive.start
    other = t + dt if opens_step else t - dt
    first, last = min(t, other), max(t, other)
    if first >= 0.0 and last <= drive.duration:
        return _excitation_at_time(drive, t)
    # The drive may jump at its start and end, within a kick. It acts for its fraction of the kick, or the
    # method would fall below second order.
    fraction = (min(last, drive.duration) - max(first, 0.0)) / (last - first)
    if not fraction > 0.0:
        return 0.0
    return fraction * _excitation_at_time(drive, min(max(t, 0.0), drive.duration))


@compiled
def _excitation_at_time(drive: ExcitationLaw, t: float) -> float:
    """Value of the drive at a time since the start of the excitation [tau]."""
    if drive.kind == TABLE:
        return drive.size * cubic_spline_value_and_slope(drive.values, drive.slopes, drive.times[1], t)[0]
    if drive.kind == IMPULSE:
        inside = t < drive.duration
        return drive.size * math.sin(math.pi * t / drive.duration) if inside else 0.0
    omega, phase, gain = drive.omega, drive.omega * t, 0.0
    if drive.kind == SWEEP:
        rate = drive.ratio / drive.duration
        omega *= math.exp(rate * t)
        phase, gain = (omega - drive.omega) / rate, omega * rate
    if drive.is_displacement:
        return drive.size * (gain * math.cos(phase) - omega * omega * math.sin(phase))
    return drive.size * math.sin(phase)


Knots = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times [s], values and slopes [1/s] of a spline at its knots."""


def _resampled_table_point_count(excitation: HostExcitation) -> int:
    spacing = float(np.diff(excitation.times).min())
    count = round((excitation.times[-1] - excitation.times[0]) / spacing) + 1
    if count > MAXIMUM_KNOTS:
        raise FieldError(
            f"the smallest interval, {spacing:g} s, requires {count} spline knots, but the limit is "
            f"{MAXIMUM_KNOTS}; give equally spaced times",
            "times",
        )
    return count


def _spline_knots_through_table(excitation: HostExcitation) -> Knots:
    """Return the knots of the cubic spline through the table, at equally spaced times."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(excitation.times, excitation.values)
    times = np.linspace(excitation.times[0], excitation.times[-1], _resampled_table_point_count(excitation))
    return times, spline(times), spline(times, 1)


def _noise_band_and_duration(excitation: HostExcitation) -> tuple[float, float, float]:
    """Return the lowest and highest frequency [Hz] and the duration [s] of noise."""
    return excitation.frequency or 0.0, excitation.to or 0.0, excitation.duration or 0.0


def _noise_knot_count(excitation: HostExcitation) -> int:
    _, highest, duration = _noise_band_and_duration(excitation)
    count = math.ceil(duration * highest * KNOTS_PER_PERIOD) + 1
    if count > MAXIMUM_KNOTS:
        raise FieldError(
            f"{duration:g} s of noise up to {highest:g} Hz requires {count} spline knots, but the limit is "
            f"{MAXIMUM_KNOTS}; give a shorter duration",
            "duration",
        )
    return count


def _noise_knots_from_random_phases(excitation: HostExcitation) -> Knots:
    """Return the knots of a sum of sines of equal amplitude, random phase and evenly spaced frequencies."""
    lowest, highest, duration = _noise_band_and_duration(excitation)
    lines = int(min(max((highest - lowest) * duration, 1.0), MAXIMUM_LINES))
    omega = math.tau * (lowest + (highest - lowest) * (np.arange(lines) + 0.5) / lines)
    phases = np.random.default_rng(excitation.seed).uniform(0.0, math.tau, lines)
    times = np.linspace(0.0, duration, _noise_knot_count(excitation))
    size = math.sqrt(2.0 / lines)
    values, slopes = np.zeros(len(times)), np.zeros(len(times))
    for rate, phase in zip(omega, phases, strict=True):
        values += size * np.sin(rate * times + phase)
        slopes += size * rate * np.cos(rate * times + phase)
    return times, values, slopes
