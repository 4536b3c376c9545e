"""Exact responses of linear hosts: alone, and with the ideal tuned mass.

A body of mass M on a spring k and a dashpot c, shaken by F sin(omega t), swings with the amplitude
|F/(k - omega^2 M + i omega c + D)|, where D is the dynamic stiffness of what hangs on it: for a
mass m on a spring s and a dashpot d, D = -omega^2 m (s + i omega d)/(s - omega^2 m + i omega d).

Without damping of the host, the tuned mass with the least peak has (Den Hartog, Mechanical
Vibrations (1956), 3.3), for the mass ratio mu = m/M,

    frequency over the host's = 1/(1 + mu),    damping ratio = sqrt(3 mu/(8 (1 + mu)^3)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from granular.effects.host import Host


def tuned_mass(host: Host, mass: float) -> tuple[float, float]:
    """Spring [N/m] and dashpot [kg/s] of Den Hartog's tuned mass [kg], on the last body."""
    body = host.bodies[-1]
    ratio = mass / body.mass
    omega = math.sqrt(body.stiffness / body.mass) / (1.0 + ratio)
    zeta = math.sqrt(3.0 * ratio / (8.0 * (1.0 + ratio) ** 3))
    return mass * omega**2, 2.0 * zeta * mass * omega


def hanging_mass(frequencies: Any, mass: float, spring: float, dashpot: float) -> np.ndarray:
    """Dynamic stiffness (f,) [N/m] of a mass on spring and dashpot, at frequencies [Hz]."""
    omega = math.tau * np.asarray(frequencies, dtype=np.float64)
    if mass == 0.0:
        return np.zeros(omega.shape, dtype=np.complex128)
    held = spring + 1j * omega * dashpot
    return np.asarray(-(omega**2) * mass * held / (held - omega**2 * mass))


def linear_response(host: Host, frequencies: Any, hung: Any = 0.0) -> np.ndarray:
    """Displacement of each body over the base (f, n) [m], complex, for the host's sine.

    Its phase is that of the force, or of the base's acceleration.

    Parameters
    ----------
    host : Host
        With an excitation, whose amplitude is taken and whose frequency is not.
    frequencies : float64 (f,)
        [Hz]
    hung : float64 (f,)
        Dynamic stiffness of what is fixed to the last body [N/m]; -omega^2 m of a mass m. Where the
        base is shaken its inertia is taken for that of such a mass.
    """
    omega = math.tau * np.asarray(frequencies, dtype=np.float64)
    count, hung = len(host.bodies), np.broadcast_to(hung, omega.shape)
    found = np.empty((len(omega), count), dtype=np.complex128)
    excited = count - 1 if host.excited is None else host.excited
    for place, rate in enumerate(omega):
        held = [body.stiffness + 1j * rate * body.damping for body in host.bodies]
        matrix = _chained(held) - np.diag([rate**2 * body.mass for body in host.bodies])
        matrix[-1, -1] += hung[place]
        force = np.zeros(count, dtype=np.complex128)
        drive = host.excitation
        if drive is not None and drive.of_base:
            shake = drive.acceleration
            if shake is None:
                shake = -(rate**2) * (drive.displacement or 0.0)
            force -= shake * np.array([body.mass for body in host.bodies])
            force[-1] += shake * hung[place] / rate**2
        elif drive is not None:
            force[excited] = drive.force or 0.0
        found[place] = np.linalg.solve(matrix, force)
    return found


def slowest_decay(host: Host) -> float:
    """Decay rate [1/s] of the host's mode that rings longest; c/(2 M) of one body."""
    count = len(host.bodies)
    springs = _chained([body.stiffness for body in host.bodies])
    dashpots = _chained([body.damping for body in host.bodies])
    masses = np.array([body.mass for body in host.bodies])[:, None]
    rates = np.block([
        [np.zeros((count, count)), np.eye(count)], [-springs.real / masses, -dashpots.real / masses]
    ])  # fmt: skip
    return float(-np.linalg.eigvals(rates).real.max())


def _chained(held: Sequence[complex]) -> np.ndarray:
    """Forces on bodies of a chain over their displacements (n, n), each held by the one before."""
    matrix = np.zeros((len(held), len(held)), dtype=np.complex128)
    for k, one in enumerate(held):
        matrix[k, k] += one
        if k:
            matrix[k - 1, k - 1] += one
            matrix[k, k - 1] -= one
            matrix[k - 1, k] -= one
    return matrix
