"""Response of a host (a structure that carries a damper) to a sweep, and settling time after an impulse."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.host_structure import Host
from granular.response.linear_system import host_amplitudes_and_damper_equivalents, slowest_decay_rate
from granular.response.response import (
    AMPLITUDES,
    PERIODS,
    POINTS,
    FrequencyResponse,
    response_dataset,
    swept_response,
)
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from granular.effects.excitation import HostExcitation

RUN = "run"
"""Subdirectory of the given directory that holds the run."""
LENGTH, DURATION = 0.02, 10.0
"""Default durations [s] of an impulse and of the run."""


def run_frequency_sweep(
    scene: Scene,
    lowest: float,
    highest: float,
    duration: float,
    *,
    points: int = POINTS,
    dt: float | str = "auto",
    out: str | Path | None = None,
    progress: bool = True,
) -> FrequencyResponse:
    """Measure the response of a scene's host in one run under a slow sweep.

    The sweep replaces the scene's drive (a force on the host or a motion of its base), and has the same
    amplitude and starting time. `swept_response` gives the maximum rate of a sweep, with which
    `relative_sweep_rate_at_peak` compares the actual rate.

    Parameters
    ----------
    scene : Scene
        Scene with a host of bodies under a drive.
    lowest, highest : float
        First and last frequency [Hz], above 0 and increasing.
    duration : float
        Duration of the sweep [s], 12 periods of the first frequency or more.
    points : int
        Number p of frequencies at which the response is given, 2 or more.
    dt : float or str
        Time step [s]; "auto" resolves the stiffest mode that the bed can reach; "auto/2" or "auto*2" is half
        or twice that step.
    out : str or Path, optional
        Directory in which the run is stored, as ``run``; repeating the same call continues from there.
    progress : bool
        Show a progress bar.

    Returns
    -------
    FrequencyResponse
        Amplitudes [m], phases [rad] and more, float64 (1, p) each, as functions of frequency [Hz].

    Raises
    ------
    InputError
        If the scene has no such host or drive, the frequencies do not increase, the sweep is shorter than 12
        periods, ``points`` is below 2, ``dt`` is not a time step, or ``out`` holds another run.
    RunError
        If the simulation fails, for example because grains leave the cell.
    """
    _, drive, key, size = _host_drive_and_amplitude(scene)
    if not 0.0 < lowest < highest < math.inf:
        raise InputError(
            f"a sweep cannot go from {lowest:g} Hz to {highest:g} Hz; give two frequencies above 0, the "
            "lower one first"
        )
    if points < 2:
        raise InputError(f"points = {points}; 2 or more are needed")
    minimum_duration = 2.0 * PERIODS / lowest
    if not minimum_duration <= duration < math.inf:
        raise InputError(
            f"a sweep of {duration:g} s is shorter than {2.0 * PERIODS:g} periods of its lowest "
            f"frequency, {lowest:g} Hz; use {minimum_duration:.3g} s or more"
        )
    sweep = {
        "kind": "sweep",
        key: size,
        "start": drive.start,
        "frequency": lowest,
        "to": highest,
        "duration": duration,
    }
    driven_scene = scene.replace(**{"effects.host.excitation": sweep})
    run = _simulate_driven(driven_scene, drive.start + duration, dt, out, progress)
    return response_of_sweep(run, points)


def response_of_sweep(run: Trajectory, points: int = POINTS) -> FrequencyResponse:
    """Compute the response of a host in a run under a sweep; see `swept_response`."""
    data = swept_response(run, points)
    host, drive, key, size = _host_drive_and_amplitude(run.scene)
    frequencies, sizes = data.frequency.values.tolist(), [size]
    amplitude = (data.displacement * np.exp(-1j * data.phase)).values[None]
    result = {
        "displacement": ("m", "amplitude of the last body", data.displacement.values[None]),
        "phase": ("rad", "phase of the last body behind the drive", data.phase.values[None]),
    }
    if "stroke" in data:
        label = "amplitude of the piston relative to the cell"
        result["stroke"] = ("m", label, data.stroke.values[None])
    result |= host_amplitudes_and_damper_equivalents(run.scene, host, key, sizes, frequencies, amplitude)
    settings = {"dt": run.settings()["dt"], "duration": drive.duration, "sweep": [drive.frequency, drive.to]}
    return FrequencyResponse(run.scene, response_dataset(key, sizes, frequencies, result), settings)


def relative_sweep_rate_at_peak(response: FrequencyResponse) -> float | None:
    """Return the sweep's rate f' at the peak, divided by the limit delta^2/(2 pi) in `swept_response`."""
    host, data = response.scene.effects.host, response.dataset
    if host is None or "sweep" not in response.settings or "added_damping" not in data:
        return None
    part = data.isel(amplitude=0)
    index = int(part.displacement.values.argmax())
    low, high = response.settings["sweep"]
    change = float(part.frequency[index]) * math.log(high / low) / response.settings["duration"]
    body = host.bodies[-1]
    mass = body.mass + float(part.effective_mass[index])
    delta = (body.damping + float(part.added_damping[index])) / (2.0 * mass)
    return None if delta <= 0.0 else math.tau * change / delta**2


@dataclasses.dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """Motion of a host after an impulse, and its settling time."""

    scene: Scene
    time: Float[np.ndarray, "n"]  # since the end of the impulse [s]
    displacement: Float[np.ndarray, "n"]  # displacement of the last body from equilibrium [m]
    fraction: float
    settling_time: float  # [s]

    @property
    def settling_time_without_damper(self) -> float:
        """Settling time ln(1/fraction)/delta [s] of the host without the damper; delta is its decay rate."""
        host = self.scene.effects.host
        assert host is not None
        delta = slowest_decay_rate(host)
        return math.inf if delta <= 0.0 else math.log(1.0 / self.fraction) / delta

    @property
    def peak(self) -> float:
        """Maximum displacement after the impulse, float [m]."""
        return float(np.abs(self.displacement).max())

    @property
    def table(self) -> pandas.DataFrame:
        """Motion after the impulse as a DataFrame with the columns ``time`` [s] and ``displacement`` [m]."""
        import pandas

        return pandas.DataFrame({"time": self.time, "displacement": self.displacement})

    def __str__(self) -> str:
        alone = (
            "never"
            if math.isinf(self.settling_time_without_damper)
            else f"{self.settling_time_without_damper:.3g} s"
        )
        return (
            f"{self.settling_time:.3g} s until the displacement stays below {self.fraction:g} of its peak, "
            f"{1e3 * self.peak:.3g} mm; without the damper {alone}"
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement [mm] against time [s], and the threshold of settling."""
        from granular.shared.plotting import COLOURS, GREY, axes_or_new

        ax = axes_or_new(ax)
        ax.plot(self.time, 1e3 * self.displacement, color=COLOURS[0], lw=0.9)
        for side in (-1.0, 1.0):
            ax.axhline(1e3 * side * self.fraction * self.peak, color=GREY, linestyle="--", lw=0.9)
        ax.axvline(self.settling_time, color=COLOURS[1], lw=1.2, label=f"{self.settling_time:.3g} s")
        ax.set(xlabel="time since the impulse [s]", ylabel="displacement [mm]")
        ax.legend(frameon=False)
        return ax


def run_impulse(
    scene: Scene,
    force: float,
    *,
    fraction: float = 0.1,
    length: float = LENGTH,
    duration: float = DURATION,
    dt: float | str = "auto",
    out: str | Path | None = None,
    progress: bool = True,
) -> ImpulseResponse:
    """Apply an impulse to a scene's host, and measure its settling time.

    The impulse replaces the scene's drive, and starts when the drive would start; without a drive, it starts
    immediately.

    Parameters
    ----------
    scene : Scene
        Scene with a host of bodies.
    force : float
        Peak force of the half-sine impulse [N]; not 0.
    fraction : float
        Fraction of the peak, above 0 and below 1; see `settling_time`.
    length : float
        Duration of the impulse [s], above 0.
    duration : float
        Duration of the simulation from the start of the impulse [s], above ``length``.
    dt : float or str
        Time step [s]; "auto" resolves the stiffest mode that the bed can reach; "auto/2" or "auto*2" is half
        or twice that step.
    out : str or Path, optional
        Directory in which the run is stored, as ``run``; repeating the call, also with another fraction or a
        longer duration, continues from there.
    progress : bool
        Show a progress bar.

    Returns
    -------
    ImpulseResponse
        Motion after the impulse, and the settling time [s].

    Raises
    ------
    InputError
        If the scene has no such host, a value is out of its limits, the host has not settled at the end, or
        ``out`` holds another run.
    RunError
        If the simulation fails, for example because grains leave the cell.
    """
    host = _require_host(scene)
    check_peak_fraction(fraction)
    if not 0.0 < abs(force) < math.inf:
        raise InputError(f"the peak force of an impulse is {force:g} N; give a finite force that is not 0")
    if not 0.0 < length < duration < math.inf:
        raise InputError(
            f"length = {length:g} s, duration = {duration:g} s; the length of the impulse must be above 0, "
            "and the run must last longer than the impulse"
        )
    start = 0.0 if host.excitation is None else host.excitation.start
    impulse_scene = {"kind": "impulse", "force": force, "start": start, "duration": length}
    scene = scene.replace(**{"effects.host.excitation": impulse_scene})
    run = _simulate_driven(scene, start + duration, dt, out, progress)
    time, displacement = run.dataset.time.values - start - length, run.dataset.host_displacement.values
    seconds, after_impulse = settling_time(run, fraction), time >= 0.0
    return ImpulseResponse(scene, time[after_impulse], displacement[after_impulse], fraction, seconds)


def _require_host(scene: Scene) -> Host:
    host = scene.effects.host
    if host is None or not host.bodies:
        raise InputError(
            f"the scene {quote(scene.name)} has no host with bodies; add effects.host.bodies, "
            "or use the packaged scene 'machine'"
        )
    return host


def _host_drive_and_amplitude(scene: Scene) -> tuple[Host, HostExcitation, str, float]:
    """Return host and drive, and the key and nonzero value of the drive's amplitude [N, m/s^2 or m]."""
    host = _require_host(scene)
    if host.excitation is None:
        raise InputError(
            f"the host of {quote(scene.name)} has no drive; add a force, an acceleration or a "
            "displacement to effects.host.excitation"
        )
    key = next(name for name in AMPLITUDES if getattr(host.excitation, name) is not None)
    size = float(getattr(host.excitation, key))
    if size == 0.0:
        raise InputError(f"the {key} of the host's drive is 0; choose a value above 0")
    return host, host.excitation, key, size


def _simulate_driven(
    scene: Scene, t_end: float, dt: float | str, out: str | Path | None, progress: bool
) -> Trajectory:
    from granular.run.simulation import simulate

    saved: dict[str, Any] = {} if out is None else {"out": Path(out) / RUN, "resume": True}
    return simulate(scene, dt=dt, t_end=t_end, progress=progress, **saved)


def settling_time(run: Trajectory, fraction: float = 0.1) -> float:
    """Measure the time from the end of an impulse until the last body stays within a fraction of its peak.

    The displacement is measured from equilibrium, and the peak is its maximum after the impulse. For a single
    body with the decay rate delta, the envelope exp(-delta t) decreases to a tenth within ln(10)/delta.

    Parameters
    ----------
    run : Trajectory
        Run of a host with bodies under an impulse.
    fraction : float
        Fraction of the peak, above 0 and below 1.

    Returns
    -------
    float
        Settling time [s], up to the record that follows the last record above the threshold.

    Raises
    ------
    InputError
        If the host has no body, no impulse acts, the fraction is out of its limits, or the run ends before
        the impulse; or if the body never moves, or has not settled at the end of the run.

    Examples
    --------
    >>> from granular import Scene, simulate
    >>> scene = Scene.from_plain({
    ...     "name": "bell", "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
    ...     "cell": {"width": "60 D"},
    ...     "piston": {"height": "20 D"},
    ...     "effects": {"host": {
    ...         "bodies": [{"mass": "2 kg", "stiffness": "800 N/m", "damping": "8 kg/s"}],
    ...         "excitation": {"kind": "impulse", "force": "5 N", "duration": "10 ms"}}},
    ...     "protocol": [{"name": "ring", "kind": "hold", "duration": "3 s"}],
    ... })
    >>> run = simulate(scene, progress=False)
    >>> from granular.response import settling_time
    >>> 1.0 < settling_time(run) < 1.3  # ln(10)/(2/s) = 1.15 s
    True
    """
    host = run.scene.effects.host
    if host is None or not host.bodies or host.excitation is None:
        raise InputError(f"the scene {quote(run.scene.name)} has no host with a drive")
    if host.excitation.kind != "impulse":
        raise InputError(
            f"the host is driven by {quote(host.excitation.kind)}; use an excitation of kind 'impulse', "
            "after which the host oscillates freely"
        )
    impulse_end = host.excitation.start + (host.excitation.duration or 0.0)
    return settling_time_of_samples(
        run.dataset.time.values, run.dataset.host_displacement.values, impulse_end, fraction
    )


def settling_time_of_samples(
    time: Float[np.ndarray, "n"], displacement: Float[np.ndarray, "n"], impulse_end: float, fraction: float
) -> float:
    """Return the time [s] after an impulse until a displacement [m] stays below a fraction of its peak."""
    check_peak_fraction(fraction)
    behind = time >= impulse_end
    if not behind.any():
        raise InputError(
            f"the run ends at {time[-1]:g} s, before the end of the impulse at {impulse_end:g} s"
        )
    sizes = np.abs(displacement[behind])
    wide = np.flatnonzero(sizes > fraction * sizes.max())
    last = int(wide[-1]) if len(wide) else 0
    if last >= len(sizes) - 1 or sizes.max() == 0.0:
        raise InputError(
            f"at the end of the run, {time[-1]:g} s, the displacement still exceeds {fraction:g} of its "
            "peak; simulate a longer time, or choose a larger fraction"
        )
    return float(time[behind][last + 1] - impulse_end)


def check_peak_fraction(fraction: float) -> None:
    """Raise an error unless a fraction of the peak is above 0 and below 1."""
    if not 0.0 < fraction < 1.0:
        raise InputError(f"fraction = {fraction:g} must be above 0 and below 1; 0.1 is a tenth of the peak")
