"""An exact problem: a scene, a time, and the state of its grains then.

Natural units stand here once more, in high precision and from the grains' material, not by way of
the engine: m = rho pi eps D^2/4, mu = Br V/mu0, F* = mu0 mu^2/(pi D^4), tau = sqrt(m D/F*)
[D, 2.2], with the source's mu0 = 4 pi 1e-7 H/m. A slip in the engine's own conversion would show as
an error that no step makes smaller.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.scene.scene import Scene
from granular.schema.apparatus import Grains

DIGITS = 50
"""Working precision; the results keep more than thirty digits of it."""

Number = Any
"""A number of mpmath, which has no types of its own."""


class NaturalUnits(NamedTuple):
    """Sizes of the natural units in SI, for grains of the first species."""

    length: Number
    mass: Number
    force: Number
    time: Number

    @property
    def velocity(self) -> Number:
        """Unit of velocity, D/tau [m/s]."""
        return self.length / self.time

    @property
    def acceleration(self) -> Number:
        """Unit of acceleration, F*/m [m/s^2]."""
        return self.force / self.mass


def natural_units(grains: Grains) -> NaturalUnits:
    """Compute the natural units in SI, in mpmath's working precision.

    Length D, mass m = rho V, force F* = mu0 mu^2/(pi D^4) with the moment mu = Br V/mu0, and time tau =
    sqrt(m D/F*) [D, 2.2].

    Parameters
    ----------
    grains : Grains
        Grains; the first species counts.

    Returns
    -------
    NaturalUnits
        Length [m], mass [kg], force [N] and time [s].
    """
    from mpmath import mpf, pi, sqrt

    diameter = mpf(grains.species[0].diameter)
    permeability = 4 * pi / 10**7
    volume = pi * mpf(grains.thickness) * diameter**2 / 4
    moment = mpf(grains.remanence) * volume / permeability
    force = permeability * moment**2 / (pi * diameter**4)
    mass = mpf(grains.density) * volume
    return NaturalUnits(diameter, mass, force, sqrt(mass * diameter / force))


class GrainStates(NamedTuple):
    """The grains at one time.

    Attributes
    ----------
    positions, velocities : float64 (n, 2)
        Of n grains, x before y [m], [m/s].
    steps : int or None
        Number of steps that a simulation took, where it chooses them itself; None otherwise.
    """

    positions: np.ndarray
    velocities: np.ndarray
    steps: int | None = None


@dataclasses.dataclass(frozen=True)
class ExactProblem:
    """A scene whose motion is known.

    Attributes
    ----------
    name, title : str
        One of `validation.exact.NAMES`, and words for a page.
    scene : Scene
        Scene of the n grains.
    time : float
        Time at which a simulation is compared with it [s].
    exact : callable
        From a time since the start [s] to the `GrainStates` then, correct to the last bit but a few.
    fewest_steps : int
        Steps up to ``time`` at which one step is about half a radian of the stiffest mode: the
        longest that a composition method of high order can be judged at.
    conservative : bool
        Whether the energy stays the same.
    smooth : bool
        Whether the motion has as many derivatives as a method of high order asks for.
    """

    name: str
    title: str
    scene: Scene
    time: float
    exact: Callable[[float], GrainStates]
    fewest_steps: int
    conservative: bool = True
    smooth: bool = True

    def perturb_start(self, last_place_units: int) -> ExactProblem:
        """Return the same problem with its start moved by a few units in the last place.

        The exact motion is not moved along: the difference between a simulation of the moved problem and
        one of this is the rounding that both suffer.

        Parameters
        ----------
        last_place_units : int
            Number n, of either sign: positions and velocities are multiplied by 1 + n eps, with the eps of
            double precision, 2.2e-16. A start without positions stays.

        Returns
        -------
        ExactProblem
            The same problem with another start and the old exact motion.

        Raises
        ------
        SceneError
            If the moved start is no scene, as where a grain comes behind a wall.
        """
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
    """Scene of grains of 5 mm in a cell 60 D wide, held for a time [s].

    Parameters
    ----------
    name : str
        Name of the scene.
    time : float
        Duration of the hold [s].
    effects : dict of str to Any
        The effects that act, as plain data.
    **parts : Any
        Further keys of the scene; ``arrangement`` must be among them.

    Returns
    -------
    Scene
        Scene with as many grains as the arrangement has positions.

    Raises
    ------
    SceneError
        If a value cannot be that of a scene.
    """
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
    """Position and velocity that a grain starts with.

    Parameters
    ----------
    scene : Scene
        Scene whose arrangement gives positions.
    grain : int
        Index of the grain.

    Returns
    -------
    (sequence of float, sequence of float)
        Position (2,) [m] and velocity (2,) [m/s].
    """
    plan = scene.arrangement
    assert plan.positions is not None
    velocity = (0.0, 0.0) if plan.velocities is None else plan.velocities[grain]
    return plan.positions[grain], velocity
