"""Forces on each grain, taken apart: those of its pairs, and of the walls.

Dipoles, discs, contacts (without their dashpots) and walls are known here. All pairs count, whatever
method of summing them a run has taken; in a periodic cell each grain meets the nearest image of
every other one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.effects.dipole import discs_unless_dipoles
from granular.effects.wall_side import evaluate_wall_forces
from granular.observables.frame import check_vectors, is_present
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.disc_law import Disc, contact_distance, disc_energy_and_force, pair_squared_distance_shift
from granular.scene.bed_drawing import body_of_side
from granular.schema.cell import Heights
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from granular.scene.scene import Scene

# Vectors of 512 rows take 50 MB with 6,000 grains.
BLOCK = 512
"""Grains whose pairs are in memory simultaneously."""

FARTHEST = 20.0
"""Distance over that of contact from which the series of a disc's field has its first term only."""

KNOWN = ("dipole", "contact", "walls")
SILENT = (
    *("bath", "drag", "eddy", "field", "friction"),
    *("gradient", "gravity", "host", "shaking", "wall_friction"),
)
"""Effects that press no grain against another one or a wall."""


class BranchesAndForces(NamedTuple):
    """Branches and forces of some grains with others."""

    grains: Int[np.ndarray, "k"]  # the grains that the forces act on
    branches: Float[np.ndarray, "k m 2"]  # from each of the m others to each of these grains [m]
    forces: Float[np.ndarray, "k m 2"]  # on these grains [N]


def effects_of_unknown_pair_force(scene: Scene) -> tuple[str, ...]:
    """Effects of a scene that act between grains by a law which is not known here."""
    return tuple(effect.key for effect in scene.effects.acting if effect.key not in (*KNOWN, *SILENT))


def iterate_pair_forces(scene: Scene, positions: Float[np.ndarray, "n 2"]) -> Iterator[BranchesAndForces]:
    """Yield branches (k, m, 2) [m] and forces [N] of all m grains on k at a time; positions [m]."""
    positions, here, system = _positions_and_natural_system(scene, positions)
    scales = system.scales
    points = positions[here]
    moments = relative_magnetic_moments(scene)[here]
    contact = _law_in_natural_units(system, "contact")
    discs, species = discs_unless_dipoles(scene.grains, scales.length), scene.grains.species_indices()[here]
    for start in range(0, len(here), BLOCK):
        some = np.arange(start, min(start + BLOCK, len(here)))
        branch = scene.cell.nearest_image_displacements(points[some, None] - points[None]) / scales.length
        r = np.linalg.norm(branch, axis=2)
        r[np.arange(len(some)), some] = np.inf
        push = np.zeros_like(r)
        if scene.effects.dipole is not None:
            push += STRENGTH * moments[some][:, None] * moments[None] / r**4
            if discs:
                push *= _disc_to_dipole_force_ratio(discs, r, species[some], species)
        if contact is not None:
            push += _contact_pair_forces(contact, r, here[some], here)
        with np.errstate(invalid="ignore"):
            forces = (push / r)[:, :, None] * branch
        yield BranchesAndForces(here[some], branch * scales.length, forces * scales.force)


def iterate_wall_forces(
    scene: Scene, positions: Float[np.ndarray, "n 2"], piston_height: Heights = None
) -> BranchesAndForces:
    """Evaluate branches (k, m, 2) [m] and forces [N] of the m walls on each grain; positions [m].

    Behind the piston's height are those of further pistons whose sides are walls.
    """
    positions, here, system = _positions_and_natural_system(scene, positions)
    scales, points = system.scales, positions[here]
    if piston_height is None:
        piston_height = np.nan if scene.piston is None else scene.piston.height
    heights = np.array([0.0, *np.atleast_1d(piston_height)])
    sides = zip(scene.cell.lines, system.constants.acting.sides, strict=True)
    acting = [(line, side) for line, side in sides if side.law is not None]
    moments, (x, y) = relative_magnetic_moments(scene)[here], np.array(points.T / scales.length)
    branches, forces = np.zeros((2, len(here), len(acting), 2))
    for k, (line, side) in enumerate(acting):
        law = side.law
        if getattr(law, "species", None) is not None:
            law = law._replace(species=system.species[here])
        pushes, seen = np.zeros((3, len(here))), side._replace(law=law)
        body = body_of_side(scene, line)
        if body >= len(heights):
            raise InputError(
                f"side {line.name!r} moves with a further piston; give its height behind the piston's"
            )
        evaluate_wall_forces(seen, x, y, heights[body] / scales.length, moments, pushes)
        distances = line.distances(points - [0.0, heights[body]], 0.0)
        branches[:, k] = distances[:, None] * line.normal
        forces[:, k] = pushes[:2].T
    return BranchesAndForces(here, branches, forces * scales.force)


def _positions_and_natural_system(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, Any]:
    """Positions, which grains are there, and the scene in natural units."""
    from granular.scene.scene_in_natural_units import scene_in_natural_units

    positions = check_vectors(positions)
    if len(positions) != scene.grains.count:
        raise InputError(f"{len(positions)} positions for {scene.grains.count} grains; give all")
    if foreign := effects_of_unknown_pair_force(scene):
        raise InputError(
            f"effects.{foreign[0]}: what it does between grains is not taken apart; ask for the "
            "resulting force instead"
        )
    return positions, np.flatnonzero(is_present(positions)), scene_in_natural_units(scene)


def _law_in_natural_units(system: Any, key: str) -> Any:
    """Law of an effect in natural units; None where it does not act."""
    for effect, law in zip(system.effects, system.constants.acting.laws, strict=True):
        if effect.key == key:
            return law
    return None


def relative_magnetic_moments(scene: Scene) -> Float[np.ndarray, "n"]:
    """Magnetic moment of each grain over that of the first species."""
    grains = scene.grains
    return np.asarray(grains.moment_ratios()[grains.species_indices()] * grains.moment_spread_factors())


def _disc_to_dipole_force_ratio(
    discs: tuple[Disc, ...], r: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Force of pairs of discs over that of dipoles; ``first`` and ``second`` are their species."""
    result = np.ones_like(r)
    for i, j in itertools.product(range(len(discs)), repeat=2):
        these = np.ix_(first == i, second == j)
        result[these] = _make_disc_to_dipole_ratio(discs[i], discs[j])(r[these])
    return result


@cache
def _make_disc_to_dipole_ratio(first: Disc, second: Disc) -> Callable[[np.ndarray], np.ndarray]:
    """Force of two discs over that of dipoles, by their distance; below contact with its slope."""
    from scipy.interpolate import CubicSpline

    from granular.pairs.disc_near_law import force_slope_at_contact

    contact, shift = contact_distance(first, second), pair_squared_distance_shift(first, second)
    # Its singular part at contact is smooth in the root of the gap.
    root = np.linspace(0.0, np.sqrt((FARTHEST - 1.0) * contact), 400)
    at = contact + root**2
    spline = CubicSpline(root, disc_energy_and_force(at, first, second)[1] * at**4 / 3.0)
    slope = force_slope_at_contact(first, second) / 3.0

    def factor(r: np.ndarray) -> np.ndarray:
        gap = r - contact
        near = spline(np.sqrt(np.clip(gap, 0.0, root[-1] ** 2)))
        far = 1.0 + 2.5 * shift / r**2
        pressed = (spline(0.0) / contact**4 + slope * np.minimum(gap, 0.0)) * np.minimum(r, contact) ** 4
        return np.where(gap < 0.0, pressed, np.where(gap < root[-1] ** 2, near, far))

    return factor


def _contact_pair_forces(law: Any, r: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    from granular.effects import contact

    push = np.zeros_like(r)
    overlap = law.radius[first][:, None] + law.radius[second][None] - r
    for i, j in np.argwhere(overlap > 0.0):
        spring = _callable_kernel(contact.hertz_spring_constant)(
            law, law.radius[first[i]], law.radius[second[j]]
        )
        push[i, j] = _callable_kernel(contact.hertz_force)(spring, overlap[i, j])
    return push


@cache
def _callable_kernel(kernel: Any) -> Any:
    """Form of a kernel that Python can call."""
    from granular.compiled import entry

    return entry(kernel)
