"""A host beside what hangs on it: alone, with the ideal tuned mass, what the damper is to it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.effects.host import Host
from granular.response.exact import hanging_mass, linear_response, tuned_mass
from granular.scene.scene import Scene


def damper_mass(scene: Scene) -> float:
    """Mass of the damper [kg]: grains, piston, and the free cell."""
    host, piston = scene.effects.host, scene.piston
    mass = float(scene.grains.masses().sum())
    if piston is not None and piston.mass is not None and (host is None or host.mount != "piston"):
        mass += piston.mass
    return mass + (0.0 if host is None or host.cell_mass is None else host.cell_mass)


def at_amplitude(host: Host, key: str, size: float) -> Host:
    """The host with another amplitude of its excitation."""
    plain = host.to_plain()
    return Host.from_plain(plain | {"excitation": plain["excitation"] | {key: size}})


def against_linear(
    scene: Scene, host: Host, key: str, sizes: Sequence[float], frequencies: Sequence[float],
    swing: np.ndarray,
) -> dict[str, tuple[str, str, np.ndarray]]:  # fmt: skip
    """Curves without damper and with the tuned mass, and what the damper is to the host."""
    omega, mass = math.tau * np.array(frequencies), damper_mass(scene)
    spring, dashpot = tuned_mass(host, mass) if host.bodies[-1].stiffness else (0.0, 0.0)
    tuned = hanging_mass(frequencies, mass, spring, dashpot)
    hosts = [at_amplitude(host, key, size) for size in sizes]
    alone = np.array([np.abs(linear_response(one, frequencies)[:, -1]) for one in hosts])
    ideal = np.array([np.abs(linear_response(one, frequencies, tuned)[:, -1]) for one in hosts])
    found = {
        "alone": ("m", "amplitude without the damper", alone),
        "ideal": ("m", "amplitude with Den Hartog's tuned mass of the same weight", ideal),
    }
    if len(host.bodies) > 1 or (host.excitation is not None and host.excitation.of_base):
        return found
    # The force of the damper on the host that leaves this displacement, as a dynamic stiffness.
    body = host.bodies[-1]
    own = body.stiffness - omega**2 * body.mass + 1j * omega * body.damping
    hung = np.array(sizes)[:, None] / swing - own
    power = 0.5 * 1j * omega * hung * np.abs(swing) ** 2  # complex: what is taken, and swings
    return found | {
        "effective_mass": ("kg", "mass that the damper adds to the host", -hung.real / omega**2),
        "added_stiffness": ("N/m", "stiffness that the damper adds to the host", hung.real),
        "added_damping": ("kg/s", "damping that the damper adds to the host", hung.imag / omega),
        "taken_power": ("W", "mean power that the damper takes", -power.real),
        "loss_factor": ("1", "power taken over that which swings", np.abs(power.real / power.imag)),
    }
