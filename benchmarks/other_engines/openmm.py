"""OpenMM on the benchmark's arrangements: the dipoles as a custom force between all pairs."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from granular.pairs import dipole_law

PLATFORMS = ("Reference", "CPU")
"""Reference: plain double precision. CPU: vectorised single precision."""


def missing() -> str | None:
    """Return the reason why OpenMM cannot run here, or None."""
    if importlib.util.find_spec("openmm") is None:
        return "OpenMM is not installed; pip install openmm"
    return None


def steps(positions: np.ndarray, platform: str) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """Make a call for one step on one core, and a call for the forces (n, 2) [F*].

    Lengths are in D in place of nm; the grains are so heavy that they do not move.
    """
    import openmm

    system, force = openmm.System(), openmm.CustomNonbondedForce(f"{dipole_law.ENERGY}/r^3")
    force.setNonbondedMethod(openmm.CustomNonbondedForce.NoCutoff)
    for _ in positions:
        system.addParticle(1e12)
        force.addParticle([])
    system.addForce(force)
    threads = {"Threads": "1"} if platform == "CPU" else {}
    integrator = openmm.VerletIntegrator(1e-6)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatformByName(platform), threads)
    context.setPositions(np.column_stack([positions, np.zeros(len(positions))]))

    def forces() -> np.ndarray:
        result: Any = context.getState(getForces=True).getForces(asNumpy=True)
        return np.asarray(result._value)[:, :2]

    return lambda: integrator.step(1), forces
