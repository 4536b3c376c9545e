"""An exact problem: a scene, a time, and the state of its grains then.

Natural units stand here once more, in high precision and from the grains' material, not by way of
the engine: m = rho pi eps D^2/4, mu = Br V/mu0, F* = mu0 mu^2/(pi D^4), tau = sqrt(m D/F*)
[D, 2.2], with the source's mu0 = 4 pi 1e-7 H/m. A slip in the engine's own conversion would show as
an error that no step makes smaller.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.scene.scene import Scene
from granular.schema.apparatus import Grains

if TYPE_CHECKING:
    from jaxtyping import Float

DIGITS = 50
"""Working precision; the results keep more than thirty digits of it."""

Number = Any
"""A number of mpmath, which has no types of its own."""


class NaturalUnits(NamedTuple):
    """Sizes of the natural units in SI, for grains of the first species."""

    length: Number  # D [m]
    mass: Number  # m [kg]
    force: Number  # F* [N]
    time: Number  # tau [s]

    @property
    def velocity(self) -> Number:
        """Unit of velocity, D/tau [m/s]."""
        return self.length / self.time

    @property
    def acceleration(self) -> Number:
        """Unit of acceleration, F*/m [m/s^2]."""
        return self.force / self.mass


def natural_units(grains: Grains) -> NaturalUnits:
    """Compute the natural units in SI, in mpmath's working precision."""
    from mpmath import mpf, pi, sqrt

    diameter = mpf(grains.species[0].diameter)
    permeability = 4 * pi / 10**7
    volume = pi * mpf(grains.thickness) * diameter**2 / 4
    moment = mpf(grains.remanence) * volume / permeability
    force = permeability * moment**2 / (pi * diameter**4)
    mass = mpf(grains.density) * volume
    return NaturalUnits(diameter, mass, force, sqrt(mass * diameter / force))


class GrainStates(NamedTuple):
    """The grains at one time."""

    positions: Float[np.ndarray, "n 2"]  # [m]
    velocities: Float[np.ndarray, "n 2"]  # [m/s]
    steps: int | None = None  # that a simulation took, if it chooses them itself


@dataclasses.dataclass(frozen=True)
class ExactProblem:
    """A scene whose motion is known."""

    name: str
    scene: Scene
    time: float  # [s]
    exact: Callable[[float], GrainStates]  # [s]
    fewest_steps: int  # steps of about half a radian of the stiffest mode
    smooth: bool = True  # has as many derivatives as a high order asks for

    def perturb_start(self, last_place_units: int) -> ExactProblem:
        """Return the same problem with its start moved by a few units in the last place."""
        # The exact motion is not moved along: the difference of both simulations is the rounding that they
        # suffer.
        plan = self.scene.arrangement
        factor = 1.0 + last_place_units * np.finfo(float).eps
        moved = {
            f"arrangement.{name}": [[factor * x, factor * y] for x, y in rows]
            for name, rows in (("positions", plan.positions), ("velocities", plan.velocities))
            if rows is not None
        }
        return dataclasses.replace(self, scene=self.scene.replace(**moved))


RECORDS = 16
"""Records of a run: enough to see how much energy is turned over, which the ledger is judged by."""


def few_grains_scene(name: str, time: float, effects: dict[str, Any], **parts: Any) -> Scene:
    """Scene of grains of 5 mm in a cell 60 D wide, held for a time [s]."""
    count = len(parts["arrangement"]["positions"])
    plain: dict[str, Any] = {
        "name": name,
        "grains": {"count": count, "species": [{"name": "grain", "diameter": "5 mm"}]},
        "cell": {"width": "60 D"},
        "effects": effects,
        "protocol": [{"kind": "hold", "name": "hold", "duration": time}],
        "output": {"scalars": time / RECORDS, "frames": time},
        **parts,
    }
    return Scene.from_plain(plain)


BOTTOM_ONLY = {"left": "none", "right": "none", "top": "none"}
"""Walls of a scene where only the bottom repels."""


def grain_start_state(scene: Scene, grain: int = 0) -> tuple[Sequence[float], Sequence[float]]:
    """Position [m] and velocity [m/s] that a grain starts with."""
    plan = scene.arrangement
    assert plan.positions is not None
    velocity = (0.0, 0.0) if plan.velocities is None else plan.velocities[grain]
    return plan.positions[grain], velocity
