"""What is measured in hard cases."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from granular.run.trajectory import Trajectory
from granular.schema.scales import Scales
from validation.exact import Problem

LEDGER = "residual of the energy ledger over the energy turned over"
FAIR = 1e-4
"""Residual beyond which the engine itself calls a run degraded."""


def ledger(run: Trajectory) -> float:
    """Residual of the energy ledger over the energy turned over."""
    return float(run.settings()["ledger_residual"])


_ENERGIES = ("kinetic", "pair", "wall", "weight", "contact", "piston")


def energy_change(run: Trajectory) -> float:
    """Energy at the end over that at the start, minus one (no losses, no work)."""
    data = run.dataset
    parts = [data[f"{one}_energy"].values for one in _ENERGIES if f"{one}_energy" in data]
    total = np.sum(parts, axis=0)
    return float(abs(total[-1] / total[0] - 1.0))


def distance_to(problem: Problem) -> Callable[[Trajectory], float]:
    """Distance from the exact place at the run's end [D]."""

    def measure(run: Trajectory) -> float:
        data = run.dataset
        exact = problem.exact(float(data["frame_time"][-1])).positions
        found = data["position"].values[-1]
        return float(np.abs(found - exact).max()) / Scales.of(run.scene.grains).length

    return measure


def greatest_way(run: Trajectory) -> float:
    """How far any grain went [D]."""
    place = run.dataset["position"].values
    return float(np.abs(place - place[0]).max()) / Scales.of(run.scene.grains).length


def terminal_fall(run: Trajectory) -> float:
    """Relative error of an overdamped grain's fall, y = y0 - v t + (v/c)(1 - e^(-c t)), v = g/c."""
    drag, gravity = run.scene.effects.drag, run.scene.effects.gravity
    assert drag is not None
    assert gravity is not None
    rate = drag.coefficient / Scales.of(run.scene.grains).mass
    data = run.dataset
    t = float(data["frame_time"][-1])
    speed = gravity.acceleration / rate
    fallen = speed * t + speed / rate * math.expm1(-rate * t)
    velocity = float(data["velocity"].values[-1, 0, 1])
    place = data["position"].values[:, 0, 1]
    # A fall of less than the place's last digits can only be told by its speed.
    told = abs(place[0] - place[-1] - fallen) - 4.0 * np.spacing(place[0])
    by_speed = abs(velocity / (speed * math.expm1(-rate * t)) - 1.0)
    return float(max(by_speed, told / fallen))


def momentum_change(run: Trajectory) -> float:
    """Change of energy or momentum over what there is of it (no walls)."""
    charge = (run.scene.grains.diameters() / run.scene.grains.species[0].diameter) ** 2
    momenta = charge[:, None] * run.dataset["velocity"].values
    scale = np.abs(momenta[0]).sum()
    lost = np.abs(momenta[-1].sum(axis=0) - momenta[0].sum(axis=0)).max() / scale
    return max(float(lost), energy_change(run))
