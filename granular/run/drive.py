"""What drives a run from outside, as columns of its piston's record: inputs for reduced models."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.effects.shaking import Shaking
from granular.protocol import Push, Stage


def base_motion(shaking: Shaking, time: np.ndarray) -> dict[str, np.ndarray]:
    """The vertical motion of a shaken cell.

    Heights of the piston are those above the moving cell, so that a law of the height has the
    inertial force of the base on its right: ``z'' + ... = g0 - base_acceleration``.

    Parameters
    ----------
    shaking : Shaking
    time : float64 (n,)
        Since the start of the run [s].

    Returns
    -------
    dict of str to float64 (n,)
        ``base_height`` [m], ``base_velocity`` [m/s], ``base_acceleration`` [m/s^2].
    """
    omega = 2.0 * math.pi * shaking.frequency
    reach = shaking.amplitude * math.sin(shaking.angle)
    height = reach * np.sin(omega * time)
    return {
        "base_height": height,
        "base_velocity": reach * omega * np.cos(omega * time),
        "base_acceleration": -(omega**2) * height,
    }


def outer_force(
    protocol: Sequence[Stage], starts: Sequence[float], stage: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """The force from outside on the free piston (n,), upwards [N]; 0 in stages without one.

    Parameters
    ----------
    protocol : sequence of Stage
    starts : sequence of float
        When each stage that was begun started [s].
    stage : int (n,)
        Place of each sample's stage in the protocol.
    time : float64 (n,)
        Since the start of the run [s].
    """
    force = np.zeros(len(time))
    for place, (one, start) in enumerate(zip(protocol, starts, strict=False)):
        if isinstance(one, Push):
            inside = stage == place
            phase = 2.0 * math.pi * one.frequency * (time[inside] - start)
            force[inside] = one.mean + one.amplitude * np.sin(phase)
    return force
