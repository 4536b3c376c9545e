"""Forces and energies of a bed in SI, summed pair by pair and wall by wall from the formulas of the guide.

The package's compiled functions are not used. Only its exact laws of two discs are used, which are
tested against magpylib.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from granular import Scene
from granular.pairs.disc_law import Disc, disc_energy_and_force, disc_torque_over_dipoles

MU_0 = 4e-7 * math.pi
SIDES = ("left", "right", "bottom", "top")

Law = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Energy [J] and repulsion [N] of pairs at the distances r [m] of grains i and j."""


@dataclasses.dataclass(frozen=True)
class Reach:
    """Distances [m] up to which pairs count, for nearest images only or for all images."""

    end: float = math.inf
    images: bool = False
    shifted: bool = False
    """True if the energy is zero at the cut-off."""


EVERYWHERE = Reach()


@dataclasses.dataclass(frozen=True)
class Bed:
    """Grains at one time, with cell and walls, in SI."""

    species: tuple[dict[str, Any], ...]
    kind: np.ndarray
    scatter: np.ndarray
    places: np.ndarray
    width: float
    separation: float
    periods: np.ndarray | None
    piston: float | None
    reach: Reach = EVERYWHERE

    def of_species(self, name: str) -> np.ndarray:
        """Return a value of each grain from the values of the species."""
        return np.array([one[name] for one in self.species])[self.kind]

    @property
    def volumes(self) -> np.ndarray:
        return math.pi / 4.0 * self.of_species("diameter") ** 2 * self.of_species("thickness")

    @property
    def masses(self) -> np.ndarray:
        return self.of_species("density") * self.volumes

    @property
    def moments(self) -> np.ndarray:
        """Return the magnetic moments [A m^2], including their random spread."""
        return self.of_species("remanence") / MU_0 * self.volumes * self.scatter

    @property
    def first_moment(self) -> float:
        one = self.species[0]
        return float(one["remanence"] / MU_0 * math.pi / 4.0 * one["diameter"] ** 2 * one["thickness"])

    @property
    def ratios(self) -> np.ndarray:
        """Return the magnetic moments, relative to the nominal moment of the first species."""
        return self.moments / self.first_moment

    @property
    def size(self) -> float:
        """Return the diameter of the first species [m]."""
        return float(self.species[0]["diameter"])

    @property
    def unit(self) -> float:
        """Return the force unit F* of the first species [N]."""
        return MU_0 * self.first_moment**2 / (math.pi * self.size**4)

    def discs(self) -> tuple[Disc, ...]:
        return tuple(Disc(0.5 * one["diameter"], one["thickness"]) for one in self.species)


def bed_of(scene: Scene, places: np.ndarray, piston: float | None = None) -> Bed:
    """Return the bed of a scene with grains at these positions [m], by default at the scene's piston
    height [m].
    """
    grains, cell = scene.grains, scene.cell
    names = ("thickness", "density", "remanence")
    values = {name: grains.species_values(name) for name in names}
    if piston is None and scene.piston is not None:
        piston = scene.piston.height
    return Bed(
        species=tuple(
            {"name": one.name, "diameter": one.diameter} | {name: values[name][k] for name in names}
            for k, one in enumerate(grains.species)
        ),
        kind=grains.species_indices(),
        scatter=grains.moment_spread_factors(),
        places=places,
        width=cell.width,
        separation=cell.separation,
        periods=None if cell.periods is None else np.array(cell.periods),
        piston=piston,
    )


@dataclasses.dataclass
class Sums:
    """Forces on the grains, energy, forces on the walls, and sums of the magnitudes of forces."""

    force: np.ndarray
    energy: float = 0.0
    walls: dict[str, float] = dataclasses.field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))
    sizes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(1))

    def __add__(self, other: "Sums") -> "Sums":
        return Sums(self.force + other.force, self.energy + other.energy, sizes=self.sizes + other.sizes)


def displacements(bed: Bed, reach: Reach) -> Iterator[np.ndarray]:
    """Return the displacements between all grains (n, n, 2) [m], image by image."""
    way = bed.places[:, None] - bed.places
    if bed.periods is None:
        yield way
        return
    way -= bed.periods * np.round(way / bed.periods)
    if not reach.images:
        yield way
        return
    most = [math.ceil(reach.end / side) + 1 for side in bed.periods]
    for across in range(-most[0], most[0] + 1):
        for up in range(-most[1], most[1] + 1):
            yield way + bed.periods * [across, up]


def sum_pairs(bed: Bed, law: Law, reach: Reach = EVERYWHERE) -> Sums:
    """Sum a law over all pairs within the given distances, including a grain with its own images."""
    count = len(bed.places)
    result = Sums(np.zeros((count, 2)), sizes=np.zeros(count))
    later = np.triu(np.ones((count, count), dtype=bool))
    for way in displacements(bed, reach):
        distance = np.hypot(way[..., 0], way[..., 1])
        i, j = np.nonzero(later & (distance > 0.0) & (distance < reach.end))
        r = distance[i, j]
        energy, push = law(r, i, j)
        if reach.shifted:
            energy = energy - law(np.full(len(r), reach.end), i, j)[0]
        force = (push / r)[:, None] * way[i, j]
        np.add.at(result.force, i, force)
        np.add.at(result.force, j, -force)
        np.add.at(result.sizes, i, np.abs(push))
        np.add.at(result.sizes, j[i != j], np.abs(push[i != j]))
        result.energy += math.fsum(np.where(i == j, 0.5, 1.0) * energy)
    return result


def dipoles(bed: Bed) -> Law:
    """Return the law of dipoles normal to the plane, with energy mu0 m m/(4 pi r^3)."""

    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        strength = MU_0 / (4.0 * math.pi) * bed.moments[i] * bed.moments[j]
        return strength / r**3, 3.0 * strength / r**4

    return law


def discs(bed: Bed) -> Law:
    """Return the law of uniformly magnetized discs. Below contact, the force is continued linearly."""

    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        energy, push, shapes = np.empty_like(r), np.empty_like(r), bed.discs()
        for a in range(len(shapes)):
            for b in range(len(shapes)):
                of_pair = (bed.kind[i] == a) & (bed.kind[j] == b)
                energy[of_pair], push[of_pair] = two_discs(r[of_pair], shapes[a], shapes[b])
        strength = MU_0 / (4.0 * math.pi) * bed.moments[i] * bed.moments[j]
        return strength * energy, strength * push

    return law


def two_discs(r: np.ndarray, first: Disc, second: Disc) -> tuple[np.ndarray, np.ndarray]:
    """Return energy and force of two discs, relative to dipoles.

    Below contact, the force is continued linearly.
    """
    contact = first.radius + second.radius
    # Far away, to 2e-5 of it, each disc adds (9/8) (R^2 - h^2/3)/r^2 to the energy of dipoles.
    b = sum(0.75 * (one.radius**2 - one.height**2 / 3.0) for one in (first, second))
    energy, push = r**-3 + 1.5 * b * r**-5, 3.0 * r**-4 + 7.5 * b * r**-6
    near = r < 8.0 * contact
    energy[near], push[near] = disc_energy_and_force(np.maximum(r[near], contact), first, second)
    below = np.minimum(r - contact, 0.0)
    if below.any():
        # The force at contact is a + b x + c x^(3/2) + ...: the slope is b.
        x = contact * np.array([0.0, 1e-4, 2e-4, 3e-4, 4e-4])
        powers = (x[:, None] / contact) ** np.array([0.0, 1.0, 1.5, 2.0, 2.5])
        slope = np.linalg.solve(powers, disc_energy_and_force(contact + x, first, second)[1])[1] / contact
        energy = energy - below * (push + 0.5 * slope * below)
        push = push + slope * below
    return energy, push


def hertz(bed: Bed, modulus: float) -> Law:
    """Return Hertz's contact law k d^(3/2) for overlap d, with k = (4/3) E* sqrt(R*)."""
    radius = 0.5 * bed.of_species("diameter")

    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        overlap = np.maximum(radius[i] + radius[j] - r, 0.0)
        k = 4.0 / 3.0 * modulus * np.sqrt(radius[i] * radius[j] / (radius[i] + radius[j]))
        return 0.4 * k * overlap**2.5, k * overlap**1.5

    return law


def field(bed: Bed, energy: np.ndarray, force: np.ndarray) -> Sums:
    """Return the sums of a force that acts on single grains."""
    return Sums(force, math.fsum(energy), sizes=np.hypot(*force.T))


WallLaw = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Energy, force away from the wall and force along it, of grains at w from it and x along it [m]."""


def sum_wall(bed: Bed, side: str, law: WallLaw) -> Sums:
    """Return the sums of a wall's law over the grains."""
    x, y = bed.places.T
    across, along = (x, y) if side in ("left", "right") else (y, x)
    end = {"left": 0.0, "right": bed.width, "bottom": 0.0, "top": bed.piston}[side]
    sign = 1.0 if side in ("left", "bottom") else -1.0
    energy, away, sideways = law(sign * (across - end), along)
    force = np.stack((sign * away, sideways), axis=1)
    if side in ("bottom", "top"):
        force = force[:, ::-1]
    result = field(bed, energy, force)
    result.walls[side] = math.fsum(away)
    return result


def power_law_wall(bed: Bed, strength: float, power: float) -> WallLaw:
    """Return the wall law of strength q (D/w)^power at distance w."""

    def law(w: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        push = strength * bed.ratios * bed.unit * (bed.size / w) ** power
        return push * w / (power - 1.0), push, 0.0 * w

    return law


def slab_wall(bed: Bed, ends: tuple[tuple[float, float], ...]) -> WallLaw:
    """Return the law of lines of dipoles between given ends [m], by integration along each line."""

    def law(w: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # Extended precision: beyond an end the two terms nearly cancel.
        energy, away, sideways = np.zeros((3, len(w)), dtype=np.longdouble)
        w, along = w.astype(np.longdouble), along.astype(np.longdouble)
        strength = 0.25 * bed.ratios * bed.unit * bed.size**3
        for start, end in ends:
            for t, sign in ((end - along, 1.0), (start - along, -1.0)):
                s = np.sqrt(w * w + t * t)
                energy += sign * strength * t / (s * w * w)
                away += sign * strength * (t / (s**3 * w) + 2.0 * t / (s * w**3))
                sideways += sign * strength / s**3
        return energy.astype(float), away.astype(float), sideways.astype(float)

    return law


def disc_row_wall(bed: Bed, pitch: float) -> WallLaw:
    """Return the law of an endless row of discs of the first species.

    One disc is half a pitch from the corner, and all centres are a radius behind the wall.
    """
    magnet, each_way = bed.discs()[0], 400

    def law(w: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        energy, away, sideways = np.zeros((3, len(w)))
        strength = MU_0 / (4.0 * math.pi) * bed.moments * bed.first_moment
        for grain in range(len(w)):
            shape, depth = bed.discs()[bed.kind[grain]], w[grain] + magnet.radius
            first = round(along[grain] / pitch)
            at = along[grain] - pitch * (first + np.arange(-each_way, each_way) + 0.5)
            r = np.hypot(at, depth)
            pair_energy, push = two_discs(r, shape, magnet)
            rest = 0.0
            for end in (along[grain] - pitch * (first - each_way), pitch * (first + each_way) - along[grain]):
                s = math.hypot(end, depth)
                rest += 1.0 / (pitch * s * (s + end))
            energy[grain] = strength[grain] * (math.fsum(pair_energy) + rest)
            away[grain] = strength[grain] * math.fsum(push * depth / r)
            sideways[grain] = strength[grain] * math.fsum(push * at / r)
        return energy, away, sideways

    return law


def torques_of_discs(bed: Bed, r: np.ndarray) -> np.ndarray:
    """Return the magnitudes of the torques between discs, relative to dipoles, for all pairs of grains."""
    result, shapes = np.ones_like(r), bed.discs()
    for a, first in enumerate(shapes):
        for b, second in enumerate(shapes):
            contact = first.radius + second.radius
            of_pair = (bed.kind[:, None] == a) & (bed.kind == b) & (r > 0.0)
            # Far away, to 2e-4 of it, by the octupoles; below contact the load is that at contact.
            octupoles = 7.5 * (first.radius**2 - first.height**2 / 3.0)
            octupoles += 2.5 * (second.radius**2 - second.height**2 / 3.0)
            result[of_pair] += 0.75 * octupoles / r[of_pair] ** 2
            near = of_pair & (r < 8.0 * contact)
            exact = disc_torque_over_dipoles(np.maximum(r[near], contact), first, second)
            result[near] = np.abs(exact) * np.minimum(r[near] / contact, 1.0) ** 3
    return result


def normal_loads(
    bed: Bed, reach: Reach, directions: str, *, second: bool, cylinders: bool = False
) -> np.ndarray:
    """Return the normal force [N] of the plates on each grain, for given directions of the tilts.

    The formula is eq. 4.11 of de Paula's thesis.
    """
    diameter, thickness = bed.of_species("diameter"), bed.of_species("thickness")
    diagonal = np.hypot(diameter, thickness)
    lean = np.arctan(thickness / diameter)
    tilt = np.arcsin(bed.separation / diagonal) - lean
    arm = np.cos(tilt) + (1.0 / 3.0 if second else 0.0)
    own = 0.75 * bed.size * arm / (np.cos(lean + tilt) * diagonal)
    other = np.sin(tilt)
    if directions == "aligned":
        own = 0.5 * own
    elif directions == "independent":
        own, other = own * other / 3.0, np.ones(len(own))
    unit = bed.unit * bed.size**3

    loads = np.zeros(len(own))
    for way in displacements(bed, reach):
        r = np.hypot(way[..., 0], way[..., 1])
        cubes = np.where((r > 0.0) & (r < reach.end), np.where(r > 0.0, r, 1.0) ** -3.0, 0.0)
        if cylinders:
            cubes *= torques_of_discs(bed, r)
        loads += unit * bed.ratios * own * (cubes @ (bed.ratios * other))
    if bed.periods is not None and reach.images:  # beyond, the sum is an integral over the plane
        beyond = 2.0 * math.pi / (float(bed.periods.prod()) * reach.end)
        loads += unit * bed.ratios * own * float((bed.ratios * other).sum()) * beyond
    return loads
