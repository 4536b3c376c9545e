"""Amplitudes of steady swings: under a sine, and while a slow sweep passes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from granular.studies.cases import keep_measure_name

if TYPE_CHECKING:
    import xarray
    from jaxtyping import Float

FRACTION = 0.4
"""Last part of a sine's duration, in which the swing is taken for steady."""
LEAST_PERIODS = 4


def complex_amplitude(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], frequency: float
) -> complex:
    """Complex A of Im(A exp(i omega t)) + constant + slope t (IEEE Std 1057); time [s], frequency [Hz]."""
    omega = math.tau * frequency
    moment = time - time.mean()
    return _amplitude_over_phase(omega * time, moment, values)


def _amplitude_over_phase(phase: np.ndarray, moment: np.ndarray, values: np.ndarray) -> complex:
    columns = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase), moment], axis=1)
    (sine, cosine, _, _), *_ = np.linalg.lstsq(columns, values, rcond=None)
    return complex(sine, cosine)


def last_whole_periods(start: float, end: float, frequency: float) -> tuple[float, float]:
    """Range of the last whole periods within `FRACTION` of a drive [s]; start, end [s], frequency [Hz]."""
    count = max(math.floor(FRACTION * (end - start) * frequency), LEAST_PERIODS)
    return max(start, end - count / frequency), end


@keep_measure_name("granular.response.steady:steady_figures#88116dfe")
def steady_figures(run: Trajectory) -> Mapping[str, Any]:
    """Amplitudes, energies and steadiness at the end of a run whose host is shaken by a sine [m, J, s]."""
    host, data = run.scene.effects.host, run.dataset
    assert host is not None
    assert host.excitation is not None
    frequency, began = float(host.excitation.frequency or 0.0), host.excitation.start
    time = data.time.values
    first, last = last_whole_periods(began, float(time[-1]), frequency)
    inside = time >= first - 1e-9  # [s]; recorded times carry rounding
    moment, drive = time[inside], time[inside] - began
    height = data.piston_height.values[inside] if "piston_height" in data else np.zeros(len(drive))
    body = data.host_displacement.values[inside] if host.bodies else height
    swing, stroke = (complex_amplitude(drive, series, frequency) for series in (body, height))
    middle = len(drive) // 2
    halves = [
        abs(complex_amplitude(drive[part], body[part], frequency))
        for part in (slice(None, middle), slice(middle, None))
    ]
    periods = (moment[-1] - moment[0]) * frequency
    figures = {
        "real": swing.real,
        "imaginary": swing.imag,
        "stroke_real": stroke.real,
        "stroke_imaginary": stroke.imag,
        "greatest": 0.5 * float(np.ptp(body)),
        "unsteady": abs(halves[1] - halves[0]) / max(0.5 * sum(halves), 1e-300),
    }
    for name in data.data_vars:
        if str(name).endswith("_loss") or name == "work":
            values = data[name].values[inside]
            figures[f"{name}_a_period"] = float(values[-1] - values[0]) / periods
    drag = run.scene.effects.drag
    if drag is not None:
        faces = run.scene.grains.face_area_ratios()[run.scene.grains.species_indices()]
        # Affine motion, v = V y/H: the drag of the grains averages to a third of its value at the piston.
        affine = drag.coefficient * float(faces.sum()) / 3.0
        figures["affine_loss_a_period"] = math.pi * math.tau * frequency * affine * abs(stroke) ** 2
    figures["last"] = last
    return figures


PERIODS = 6.0
"""Periods of the drive in which one amplitude is resolved."""
POINTS = 200


def swept_response(run: Trajectory, points: int = POINTS) -> xarray.Dataset:
    """Amplitudes of the last body and of the piston while a sweep passes, in one run.

    About each moment, over 6 periods of the drive, the displacement is taken for
    a sin(phase) + b cos(phase) + c + d t with the phase of the sweep (least squares, as the sine fit of
    IEEE Std 1057 in `complex_amplitude`). A sweep shows the steady response where its frequency
    changes little while the machine forgets: with the change f' of the frequency and the decay rate
    delta, f' << delta^2/(2 pi). This is the toolkit's own estimate: within a decay, 1/delta, the
    frequency moves by much less than the peak's half-width, delta/(2 pi). A hardening or softening
    machine jumps elsewhere upwards than downwards.

    Parameters
    ----------
    run : Trajectory
        Run of a host with bodies under a sweep, finished or cut off.
    points : int
        Number p of frequencies of the result, from 2.

    Returns
    -------
    xarray.Dataset
        On ``frequency`` (p,) [Hz], increasing: ``displacement`` [m], ``phase`` behind the drive, from -pi
        to pi [rad], and ``stroke`` of the piston over the cell [m] where there is a piston.

    Raises
    ------
    InputError
        If the host has no bodies or is not shaken by a sweep, ``points`` is below 2, or the run holds
        less than 6 periods of the sweep.
    """
    import xarray

    host = run.scene.effects.host
    drive = None if host is None else host.excitation
    if host is None or drive is None or drive.kind != "sweep" or not host.bodies:
        raise InputError(
            f"the scene {quote(run.scene.name)} has no host under a sweep; give effects.host "
            "bodies, and an excitation of the kind 'sweep'"
        )
    low, high = float(drive.frequency or 0.0), float(drive.to or 0.0)
    length, data = float(drive.duration or 0.0), run.dataset
    time = data.time.values - drive.start
    seen = {"displacement": data.host_displacement.values}
    if "piston_height" in data:
        seen["stroke"] = data.piston_height.values
    frequencies, swings = swept_amplitudes(time, list(seen.values()), (low, high, length), points)
    result = {
        name: ("frequency", np.abs(swing), {"units": "m"}) for name, swing in zip(seen, swings, strict=True)
    }
    result["phase"] = ("frequency", -np.angle(swings[0]), {"units": "rad"})
    return xarray.Dataset(result, coords={"frequency": ("frequency", frequencies, {"units": "Hz"})})


def swept_amplitudes(
    time: Float[np.ndarray, "n"], values: list[np.ndarray], sweep: tuple[float, float, float], points: int
) -> tuple[Float[np.ndarray, "p"], list[np.ndarray]]:
    """Complex amplitudes in an exponential sweep by local least squares; time [s], sweep [Hz, Hz, s]."""
    low, high, length = sweep
    if points < 2:
        raise InputError(f"points = {points}; give at least 2")
    rate = math.log(high / low) / length
    phase = math.tau * low * np.expm1(rate * time) / rate
    middles = math.log1p(rate * 0.5 * PERIODS / low) / rate  # half the first span
    last = min(length, float(time[-1]))
    moments = np.linspace(middles, last - 0.5 * PERIODS / (low * math.exp(rate * last)), points)
    if moments[-1] <= moments[0]:
        raise InputError(
            f"the run holds {last:g} s of the sweep, less than {PERIODS:g} of its periods; run longer"
        )
    frequencies = low * np.exp(rate * moments)
    swings = [np.empty(points, dtype=np.complex128) for _ in values]
    for k, (moment, frequency) in enumerate(zip(moments, frequencies, strict=True)):
        near = np.abs(time - moment) <= 0.5 * PERIODS / frequency
        for swing, value in zip(swings, values, strict=True):
            swing[k] = _amplitude_over_phase(phase[near], time[near] - moment, value[near])
    return frequencies, swings
