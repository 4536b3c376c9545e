"""A scene in natural units, as the compiled loop takes it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from granular.effects.walls import WallLaws
from granular.pairs.direct import padded_values
from granular.scales import Scales
from granular.scene import Scene


class Acting(NamedTuple):
    """The effects that act; None is compiled away.

    Attributes
    ----------
    dipole : bool or None
    walls : WallLaws
    gravity : float or None
        G [F*/m].
    drag : float or None
        Decay rate [1/tau].
    """

    dipole: bool | None
    walls: WallLaws
    gravity: float | None
    drag: float | None


class Constants(NamedTuple):
    """What stays the same during a run.

    Attributes
    ----------
    grains : int
        Number of grains.
    charge : float64 (m,) or None
        Moment and mass of each grain over those of the first species; None where all are alike.
    lightest : float
        Least charge.
    width : float
        Cell width [D].
    mass, weight : float
        Of the piston [m], [F*]; the mass is infinite where none is given.
    acting : Acting
    threaded : bool or None
        None for one thread.
    """

    grains: int
    charge: np.ndarray | None
    lightest: float
    width: float
    mass: float
    weight: float
    acting: Acting
    threaded: bool | None


@dataclasses.dataclass(frozen=True)
class System:
    """A compiled scene: the natural units, the constants, and the species of each grain."""

    scales: Scales
    constants: Constants
    species: np.ndarray


def natural_system(scene: Scene, *, threads: int = 1) -> System:
    """The scene in natural units."""
    scales = Scales.of(scene.grains)
    effects = scene.effects
    species = scene.grains.assignment()
    ratios = np.array([one.diameter for one in scene.grains.species])
    ratios = (ratios / scales.length) ** 2
    open_cell = WallLaws(None, None, None, None)
    gravity = None if effects.gravity is None else effects.gravity.kernel(scales)
    mass = np.inf
    if scene.piston is not None and scene.piston.mass is not None:
        mass = scene.piston.mass / scales.mass
    constants = Constants(
        grains=len(species),
        charge=None if len(ratios) == 1 else padded_values(ratios[species]),
        lightest=float(ratios.min()),
        width=scene.cell.width / scales.length,
        mass=mass,
        weight=mass * (gravity or 0.0) if np.isfinite(mass) else 0.0,
        acting=Acting(
            dipole=None if effects.dipole is None else True,
            walls=open_cell if effects.walls is None else effects.walls.kernel(),
            gravity=gravity,
            drag=None if effects.drag is None else effects.drag.kernel(scales),
        ),
        threaded=None if threads == 1 else True,
    )
    return System(scales, constants, species)
