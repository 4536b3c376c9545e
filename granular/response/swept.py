"""A frequency response read off one slow sweep."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.messages import quoted

if TYPE_CHECKING:
    import xarray

PERIODS = 6.0
"""Of the drive, in which one amplitude is told."""
POINTS = 200


def swept_response(run: Trajectory, points: int = POINTS) -> xarray.Dataset:
    """Amplitudes of the last body and of the piston while a sweep passes, in one run.

    About each moment, over `PERIODS` of the drive, the displacement is taken for
    a sin(phase) + b cos(phase) + c + d t with the phase of the sweep (least squares). A sweep shows
    the steady response where its frequency changes little while the machine forgets: with the
    change f' of the frequency and the decay rate delta, f' << delta^2/(2 pi). A hardening or
    softening machine jumps elsewhere upwards than downwards.

    Returns
    -------
    xarray.Dataset
        On ``frequency`` [Hz]: ``displacement`` [m], ``phase`` behind the drive [rad], and
        ``stroke`` of the piston over the cell [m] where there is one.

    Raises
    ------
    InputError
        If the host is not shaken by a sweep, or the run is too short for one point.
    """
    import xarray

    host = run.scene.effects.host
    drive = None if host is None else host.excitation
    if host is None or drive is None or drive.kind != "sweep" or not host.bodies:
        raise InputError(
            f"the scene {quoted(run.scene.name)} has no host under a sweep; give effects.host "
            "bodies, and an excitation of the kind 'sweep'"
        )
    low, high = float(drive.frequency or 0.0), float(drive.to or 0.0)
    length, data = float(drive.duration or 0.0), run.dataset
    time = data.time.values - drive.start
    seen = {"displacement": data.host_displacement.values}
    if "piston_height" in data:
        seen["stroke"] = data.piston_height.values
    frequencies, swings = swept_amplitudes(
        time, list(seen.values()), (low, high, length), points
    )  # fmt: skip
    found = {
        name: ("frequency", np.abs(one), {"units": "m"})
        for name, one in zip(seen, swings, strict=True)
    }
    found["phase"] = ("frequency", -np.angle(swings[0]), {"units": "rad"})
    return xarray.Dataset(found, coords={"frequency": ("frequency", frequencies, {"units": "Hz"})})


def swept_amplitudes(
    time: np.ndarray, values: list[np.ndarray], sweep: tuple[float, float, float], points: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Frequencies (p,) [Hz] and complex amplitudes (p,) of each of the values (n,).

    Parameters
    ----------
    time : float64 (n,)
        Since the beginning of the sweep [s].
    sweep : (float, float, float)
        First and last frequency [Hz], and duration [s].
    """
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
            f"the run holds {last:g} s of the sweep, less than {PERIODS:g} of its periods; run "
            "longer"
        )
    frequencies = low * np.exp(rate * moments)
    swings = [np.empty(points, dtype=np.complex128) for _ in values]
    for k, (moment, frequency) in enumerate(zip(moments, frequencies, strict=True)):
        near = np.abs(time - moment) <= 0.5 * PERIODS / frequency
        columns = np.stack(
            [np.sin(phase[near]), np.cos(phase[near]), np.ones(near.sum()), time[near] - moment],
            axis=1,
        )
        for swing, one in zip(swings, values, strict=True):
            (sine, cosine, _, _), *_ = np.linalg.lstsq(columns, one[near], rcond=None)
            swing[k] = complex(sine, cosine)
    return frequencies, swings
