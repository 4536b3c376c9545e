"""A hard case, and the errors that are measured in hard cases."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from validation.exact import ExactProblem

FAIR = 1e-4
"""Residual of the ledger beyond which the engine itself calls a run degraded."""

BROKEN = ("EnergyError", "NotFiniteError", "OutsideError")
"""Errors that a step that is too long may end in."""


class ErrorMeasure(NamedTuple):
    """An error of a finished run."""

    description: str
    error: Callable[[Trajectory], float]


LEDGER = ErrorMeasure(
    "residual of the energy ledger over the energy turned over",
    lambda run: float(run.settings()["ledger_residual"]),
)


@dataclasses.dataclass(frozen=True)
class HardCase:
    """One entry of the catalogue."""

    name: str
    difficulty: str
    scene: Callable[[], Scene]
    quick_time: float = 0.05  # [s]
    full_time: float = 1.0  # [s]
    measure: ErrorMeasure = LEDGER
    limit: float = FAIR  # error up to which the run is accurate
    errors: tuple[str, ...] = ()  # names of those that may end it
    dt: float | str = "auto"
    may_degrade: bool = False  # a warning may take the place of accuracy


_ENERGIES = ("kinetic", "pair", "wall", "weight", "contact", "piston")


def energy_change(run: Trajectory) -> float:
    """Compute the relative change of the energy over a run in which nothing is lost and no work done.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off, with at least one record of an energy.

    Returns
    -------
    float
        Magnitude of the change over the energy at the start (kinetic, pairs, walls, weight, contacts and
        piston), without unit; NaN or infinite where that is 0.
    """
    data = run.dataset
    parts = [data[f"{energy}_energy"].values for energy in _ENERGIES if f"{energy}_energy" in data]
    total = np.sum(parts, axis=0)
    return float(abs(total[-1] / total[0] - 1.0))


def make_distance_from_exact(problem: ExactProblem) -> Callable[[Trajectory], float]:
    """Make the measure of the distance from a problem's exact place at the run's end [D]."""

    def measure(run: Trajectory) -> float:
        data = run.dataset
        exact = problem.exact(float(data["frame_time"][-1])).positions
        off = data["position"].values[-1] - exact
        return float(np.abs(off).max()) / Scales.from_grains(run.scene.grains).length

    return measure


def greatest_displacement(run: Trajectory) -> float:
    """Greatest displacement of any grain along an axis [D]."""
    positions = run.dataset["position"].values
    return float(np.abs(positions - positions[0]).max()) / Scales.from_grains(run.scene.grains).length


def terminal_fall_error(run: Trajectory) -> float:
    """Relative error of an overdamped grain's fall."""
    # Against y = y0 - v t + (v/c)(1 - e^(-c t)), v = g/c, c = gamma/m.
    drag, gravity = run.scene.effects.drag, run.scene.effects.gravity
    assert drag is not None
    assert gravity is not None
    rate = drag.coefficient / Scales.from_grains(run.scene.grains).mass
    data = run.dataset
    t = float(data["frame_time"][-1])
    speed = gravity.acceleration / rate
    fallen = speed * t + speed / rate * math.expm1(-rate * t)
    velocity = float(data["velocity"].values[-1, 0, 1])
    heights = data["position"].values[:, 0, 1]
    # A fall of less than the place's last digits can only be told by its speed.
    by_place = abs(heights[0] - heights[-1] - fallen) - 4.0 * np.spacing(heights[0])
    by_speed = abs(velocity / (speed * math.expm1(-rate * t)) - 1.0)
    return float(max(by_speed, by_place / fallen))


def energy_or_momentum_change(run: Trajectory) -> float:
    """Compute the greater of the relative changes of energy and momentum over a run."""
    # Grains are equally thick: their masses go with the squares of their diameters.
    charge = (run.scene.grains.diameters() / run.scene.grains.species[0].diameter) ** 2
    momenta = charge[:, None] * run.dataset["velocity"].values
    scale = np.abs(momenta[0]).sum()
    lost = np.abs(momenta[-1].sum(axis=0) - momenta[0].sum(axis=0)).max() / scale
    return max(float(lost), energy_change(run))


def cut_to_few_grains(name: str, **changes: Any) -> Scene:
    """Return the packaged scene cut down to 23 grains."""
    size = {"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "arrangement.height": "5.5 D"}
    if name == "damper":
        size["piston.mass"] = 1.0
    return load_scene(name).replace(**{**size, **changes})
