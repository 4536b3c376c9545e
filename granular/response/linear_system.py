"""Exact responses of linear hosts without a damper and with an ideal tuned mass.

A host is the structure that carries the damper. The mass and dashpot equivalent to the damper are also
computed here. A body of mass M on a spring k and a dashpot c, driven by F sin(omega t), oscillates with the
amplitude |F/(k - omega^2 M + i omega c + D)|. Here D is the dynamic stiffness of the attached system. For a
mass m on a spring s and a dashpot d, D = -omega^2 m (s + i omega d)/(s - omega^2 m + i omega d).

For an undamped host, the tuned mass that gives the lowest peak has, with the mass ratio mu = m/M (Den Hartog,
Mechanical Vibrations (1956), 3.3),

    frequency/(frequency of the host) = 1/(1 + mu),    damping ratio = sqrt(3 mu/(8 (1 + mu))).

This damping ratio is relative to the critical damping of the tuned mass at the frequency of the tuned mass.
Den Hartog's ratio refers to the frequency of the host, which is higher by the factor 1 + mu.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from granular.effects.host_structure import Host
from granular.linear.bed_forces import mass_stiffness_and_damping_of_chain
from granular.scene.scene import Scene
from granular.shared.array_types import Complex, Float


def tuned_mass_spring_and_dashpot(host: Host, mass: float) -> tuple[float, float]:
    """Return spring [N/m] and dashpot [kg/s] of Den Hartog's tuned ``mass`` [kg] on the host's last body."""
    body = host.bodies[-1]
    ratio = mass / body.mass
    omega = math.sqrt(body.stiffness / body.mass) / (1.0 + ratio)
    zeta = math.sqrt(3.0 * ratio / (8.0 * (1.0 + ratio)))
    return mass * omega**2, 2.0 * zeta * mass * omega


def dynamic_stiffness_of_hanging_mass(
    frequencies: Any, mass: float, spring: float, dashpot: float
) -> Complex[np.ndarray, "f"]:
    """Return the dynamic stiffness (f,) [N/m] of a mass [kg] on a spring [N/m] and a dashpot [kg/s]."""
    omega = math.tau * np.asarray(frequencies, dtype=np.float64)
    if mass == 0.0:
        return np.zeros(omega.shape, dtype=np.complex128)
    held = spring + 1j * omega * dashpot
    return np.asarray(-(omega**2) * mass * held / (held - omega**2 * mass))


def linear_response(host: Host, frequencies: Any, attached: Any = 0.0) -> Complex[np.ndarray, "f n"]:
    """Return a host's displacements (f, n) [m] with the dynamic stiffness [N/m] ``attached`` at its end."""
    omega = math.tau * np.asarray(frequencies, dtype=np.float64)
    masses, springs, dashpots = mass_stiffness_and_damping_of_chain(host)
    rates, drive = 1j * omega[:, None, None], host.excitation
    matrices = springs + rates * dashpots + rates**2 * np.diag(masses)
    matrices[:, -1, -1] += attached
    force = np.zeros((len(omega), len(masses)), dtype=np.complex128)
    if drive is not None and drive.is_base_motion:
        shake = -(omega**2) * (drive.displacement or 0.0)
        if drive.acceleration is not None:
            shake = np.full(omega.shape, drive.acceleration)
        force -= shake[:, None] * masses
        force[:, -1] += shake * attached / omega**2
    elif drive is not None:
        force[:, -1 if host.excited is None else host.excited] = drive.force or 0.0
    return np.asarray(np.linalg.solve(matrices, force[..., None])[..., 0])


def slowest_decay_rate(host: Host) -> float:
    """Return the smallest decay rate [1/s] of the host's modes: c/(2 M) for a single weakly damped body."""
    masses, springs, dashpots = mass_stiffness_and_damping_of_chain(host)
    inertia, identity = masses[:, None], np.eye(len(masses))
    rates = np.block([[0.0 * identity, identity], [-springs / inertia, -dashpots / inertia]])
    return float(-np.linalg.eigvals(rates).real.max())


def total_damper_mass(scene: Scene) -> float:
    """Return the total mass [kg] of grains, piston and cell, without a piston or cell fixed to the host."""
    host, piston = scene.effects.host, scene.piston
    mass = float(scene.grains.masses().sum())
    if piston is not None and piston.mass is not None and (host is None or host.mount != "piston"):
        mass += piston.mass
    return mass + (0.0 if host is None or host.cell_mass is None else host.cell_mass)


def amplitudes_without_damper_and_with_tuned_mass(
    scene: Scene, host: Host, quantity: str, amplitude: float, frequencies: Any
) -> Float[np.ndarray, "2 f"]:
    """Return the amplitudes [m] of a host alone and with a tuned mass, at each frequency [Hz]."""
    plain, mass = host.to_plain(), total_damper_mass(scene)
    driven = Host.from_plain(plain | {"excitation": plain["excitation"] | {quantity: amplitude}})
    spring, dashpot = tuned_mass_spring_and_dashpot(host, mass) if host.bodies[-1].stiffness else (0.0, 0.0)
    tuned = dynamic_stiffness_of_hanging_mass(frequencies, mass, spring, dashpot)
    return np.abs([linear_response(driven, frequencies, hung)[:, -1] for hung in (0.0, tuned)])


def host_amplitudes_and_damper_equivalents(
    scene: Scene,
    host: Host,
    quantity: str,
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    response: Complex[np.ndarray, "s f"],
) -> dict[str, tuple[str, str, np.ndarray]]:
    """Compute amplitudes of a host alone and with a tuned mass, and the damper's added mass and damping."""
    omega = math.tau * np.array(frequencies)
    curves = [
        amplitudes_without_damper_and_with_tuned_mass(scene, host, quantity, size, frequencies)
        for size in amplitudes
    ]
    alone, ideal = np.stack(curves, axis=1)
    result = {
        "alone": ("m", "amplitude without the damper", alone),
        "ideal": ("m", "amplitude with Den Hartog's tuned mass of the same weight", ideal),
    }
    # The damper's dynamic stiffness is determined only by a force on a single body.
    if len(host.bodies) > 1 or (host.excitation is not None and host.excitation.is_base_motion):
        return result
    # The damper's force on the host that produces this displacement, as a dynamic stiffness.
    body = host.bodies[-1]
    host_stiffness = body.stiffness - omega**2 * body.mass + 1j * omega * body.damping
    added = np.array(amplitudes)[:, None] / response - host_stiffness
    power = 0.5 * 1j * omega * added * np.abs(response) ** 2  # complex: dissipated and reactive power
    return result | {
        "effective_mass": ("kg", "mass that the damper adds to the host", -added.real / omega**2),
        "added_stiffness": ("N/m", "stiffness that the damper adds to the host", added.real),
        "added_damping": ("kg/s", "damping that the damper adds to the host", added.imag / omega),
        "taken_power": ("W", "mean power dissipated by the damper", -power.real),
        "loss_factor": ("1", "ratio of dissipated to reactive power", np.abs(power.real / power.imag)),
    }
