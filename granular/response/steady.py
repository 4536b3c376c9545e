"""What a steady swing says: complex amplitudes, and what is taken in a period."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.run.trajectory import Trajectory

SHARE = 0.4
"""Of the time that a sine acts, the last part, in which the swing is taken for steady."""
LEAST_PERIODS = 4


def complex_amplitude(time: np.ndarray, values: np.ndarray, frequency: float) -> complex:
    """A of values = Im(A exp(i omega t)) + constant + slope t, by least squares."""
    omega = math.tau * frequency
    moment = time - time.mean()
    columns = np.stack(
        [np.sin(omega * time), np.cos(omega * time), np.ones_like(time), moment], axis=1
    )
    (sine, cosine, _, _), *_ = np.linalg.lstsq(columns, values, rcond=None)
    return complex(sine, cosine)


def whole_periods(start: float, end: float, frequency: float) -> tuple[float, float]:
    """The last whole periods of the last part of a time [s]; at least `LEAST_PERIODS` of them."""
    count = max(math.floor(SHARE * (end - start) * frequency), LEAST_PERIODS)
    return max(start, end - count / frequency), end


def steady_figures(run: Trajectory) -> Mapping[str, Any]:
    """Figures of the steady swing at the end of a run whose host is shaken by a sine, in SI.

    ``real`` and ``imaginary`` parts of the displacement of the last body (of the load on the piston
    where the cell stands on the base) and of the piston over the cell, with the phase of the drive;
    the energies taken in a period; ``unsteady``, by how much the amplitudes of both halves of the
    time differ, over their mean.
    """
    host, data = run.scene.effects.host, run.dataset
    assert host is not None
    assert host.excitation is not None
    frequency, began = float(host.excitation.frequency or 0.0), host.excitation.start
    time = data.time.values
    first, last = whole_periods(began, float(time[-1]), frequency)
    inside = time >= first - 1e-9
    moment, drive = time[inside], time[inside] - began
    height = data.piston_height.values[inside] if "piston_height" in data else np.zeros(len(drive))
    body = data.host_displacement.values[inside] if host.bodies else height
    swing, stroke = (complex_amplitude(drive, one, frequency) for one in (body, height))
    middle = len(drive) // 2
    halves = [
        abs(complex_amplitude(drive[part], body[part], frequency))
        for part in (slice(None, middle), slice(middle, None))
    ]
    periods = (moment[-1] - moment[0]) * frequency
    figures = {
        "real": swing.real, "imaginary": swing.imag,
        "stroke_real": stroke.real, "stroke_imaginary": stroke.imag,
        "greatest": 0.5 * float(np.ptp(body)),
        "unsteady": abs(halves[1] - halves[0]) / max(0.5 * sum(halves), 1e-300),
    }  # fmt: skip
    for name in data.data_vars:
        if str(name).endswith("_loss") or name == "work":
            values = data[name].values[inside]
            figures[f"{name}_a_period"] = float(values[-1] - values[0]) / periods
    drag = run.scene.effects.drag
    if drag is not None:
        shaken = run.scene.grains.masses() / run.scene.grains.masses()[0]
        affine = drag.coefficient * float(shaken.sum()) / 3.0
        figures["affine_loss_a_period"] = math.pi * math.tau * frequency * affine * abs(stroke) ** 2
    figures["last"] = last
    return figures
