"""A scene in natural units, as the compiled loop takes it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.contact import ContactLaw
from granular.effects.friction import FrictionLaw
from granular.effects.shaking import Swing
from granular.effects.walls import OPEN, WallLaws
from granular.methods import Method
from granular.pairs.direct import padded_values
from granular.pairs.far_field import MOST_POINTS, SPACINGS, FarField
from granular.pairs.stripes import CutOff
from granular.pairs.verlet_list import Listing
from granular.scene.parts import Piston
from granular.scene.scales import Scales
from granular.scene.scene import Scene
from granular.shared.errors import InputError


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
    friction : FrictionLaw or None
    contact : ContactLaw or None
    shaking : Swing or None
    cut : CutOff or None
        Where pairs end; with None for this and the next, all pairs are summed.
    listing : Listing or None
        Of the source's Verlet list.
    far : FarField or None
        What is beyond the radius where pairs end smoothly.
    """

    dipole: bool | None
    walls: WallLaws
    gravity: float | None
    drag: float | None
    friction: FrictionLaw | None
    contact: ContactLaw | None
    shaking: Swing | None
    cut: CutOff | None
    listing: Listing | None
    far: FarField | None


class Resistance(NamedTuple):
    """What holds a free piston back.

    Attributes
    ----------
    rate : float
        Decay rate of its velocity [1/tau].
    force : float
        Coulomb friction [F*].
    """

    rate: float
    force: float


class Constants(NamedTuple):
    """What stays the same during a run (but that grains may leave).

    Attributes
    ----------
    grains : int
        Number of grains.
    masses : float64 (m,) or None
        Mass of each grain over that of the first species; None where all are alike.
    moments : float64 (m,) or None
        Magnetic moment of each grain over that of the first species. None where these are the same
        numbers as the masses, as in species of one material and thickness: a second array in here
        makes a step of 92 grains 10 % slower. Kernels ask `moments_of`.
    least_mass, least_moment : float
        Of the lightest species.
    width : float
        Cell width [D].
    piston_mass, piston_weight : float
        [m], [F*]; the mass is infinite where none is given.
    resistance : Resistance or None
        Of the piston.
    exit : float
        Height below which a grain has left through a gap [D]; minus infinity where there is none.
    acting : Acting
    threaded : bool or None
        None for one thread.
    """

    grains: int
    masses: Array | None
    moments: Array | None
    least_mass: float
    least_moment: float
    width: float
    piston_mass: float
    piston_weight: float
    resistance: Resistance | None
    exit: float
    acting: Acting
    threaded: bool | None


@compiled(inline=True)
def moments_of(constants: Constants) -> Array | None:
    """Magnetic moment of each grain over that of the first species; None where all are alike."""
    return _given(constants.moments, constants.masses)


@compiled(inline=True)
def _given(values: Array | None, otherwise: Array | None) -> Array | None:
    return otherwise if values is None else values


FAR_EVERY = 8
"""Steps from one evaluation of the far field to the next: 0.8 of the inverse of the highest angular
frequency with the automatic step, well short of resonance with the fastest mode, at pi of it
(Biesiadecki and Skeel 1993, doi:10.1006/jcph.1993.1220)."""

HEADROOM = 1.5
"""Room of the far field over the greatest height that is known beforehand: a piston may bounce."""

EXIT = -5.0
"""A grain this far below a gap [D] has left: the slabs' force on it is below a thousandth of F*."""


@dataclasses.dataclass(frozen=True)
class System:
    """A compiled scene: the natural units, the constants, and the species of each grain."""

    scales: Scales
    constants: Constants
    species: np.ndarray


def natural_system(scene: Scene, *, threads: int = 1, method: Method | None = None) -> System:
    """The scene in natural units, for a method of integration.

    Raises
    ------
    InputError
        If the far field cannot act at longer steps with that method.
    """
    scales = Scales.of(scene.grains)
    species = scene.grains.assignment()
    ratios = np.array([one.diameter for one in scene.grains.species])
    ratios = (ratios / scales.length) ** 2
    acting = _acting(scene, scales, species, method)
    masses = None if len(ratios) == 1 else padded_values(ratios[species])
    piston_mass, piston_weight = _piston_mass(scene, scales, acting.gravity)
    walls = scene.effects.walls
    constants = Constants(
        grains=len(species),
        masses=masses,
        moments=None,
        least_mass=float(ratios.min()),
        least_moment=float(ratios.min()),
        width=scene.cell.width / scales.length,
        piston_mass=piston_mass,
        piston_weight=piston_weight,
        resistance=_resistance(scene.piston, scales),
        exit=EXIT if walls is not None and walls.has_gap else -np.inf,
        acting=acting,
        threaded=None if threads == 1 else True,
    )
    return System(scales, constants, species)


def _acting(scene: Scene, scales: Scales, species: np.ndarray, method: Method | None) -> Acting:
    effects, grains = scene.effects, scene.grains
    walls, friction, contact = effects.walls, effects.friction, effects.contact
    summed = None if effects.dipole is None else scene.pair_method
    radius = scene.pairs.radius(summed, scales.length)
    smooth = True if summed == "mesh" else None
    return Acting(
        dipole=None if effects.dipole is None else True,
        walls=OPEN if walls is None else walls.kernel(scene.cell.width, scales.length),
        gravity=None if effects.gravity is None else effects.gravity.kernel(scales),
        drag=None if effects.drag is None else effects.drag.kernel(scales),
        friction=None if friction is None else friction.kernel(grains, scene.cell, scales, species),
        contact=None if contact is None else contact.kernel(grains, scales, species),
        shaking=None if effects.shaking is None else effects.shaking.kernel(scales),
        cut=None if radius is None else CutOff(radius, len(grains.species) > 1, smooth),
        listing=scene.pairs.listing(scales.length) if summed == "verlet-list" else None,
        far=None if smooth is None or radius is None else _far_field(scene, scales, radius, method),
    )


def _far_field(scene: Scene, scales: Scales, radius: float, method: Method | None) -> FarField:
    height = HEADROOM * scene.greatest_height() / scales.length
    width = scene.cell.width / scales.length
    points = width * height * (SPACINGS / radius) ** 2
    if points > MOST_POINTS:
        raise InputError(
            f"pairs.method = 'mesh' needs {points:.3g} points over {width:.3g} x {height:.3g} D, "
            f"{MOST_POINTS:g} is the limit; take 'direct', a smaller cell or a longer pairs.cut_off"
        )
    return FarField(radius, width, height, _far_every(scene, method))


def _far_every(scene: Scene, method: Method | None) -> int | None:
    """Steps from impulse to impulse of the far field; None where it is a part of every force."""
    wanted = scene.pairs.far_every
    rubs = scene.effects.friction is not None
    able = method is not None and method.takes_impulses and not rubs
    if wanted is None:
        return FAR_EVERY if able else None
    if wanted > 1 and method is not None and not able:
        why = "grains rub, and need the whole force to stick" if rubs else f"{method.name!r} cannot"
        raise InputError(
            f"pairs.far_every = {wanted}: {why}; leave it away, or take 1"
            + ("" if rubs else " or 'stormer-verlet'")
        )
    return wanted if able and wanted > 1 else None


def _piston_mass(scene: Scene, scales: Scales, gravity: float | None) -> tuple[float, float]:
    if scene.piston is None or scene.piston.mass is None:
        return np.inf, 0.0
    mass = scene.piston.mass / scales.mass
    return mass, mass * (gravity or 0.0)


def _resistance(piston: Piston | None, scales: Scales) -> Resistance | None:
    if piston is None or piston.mass is None or not (piston.drag or piston.friction):
        return None
    return Resistance(
        rate=piston.drag * scales.time / piston.mass, force=piston.friction / scales.force
    )
