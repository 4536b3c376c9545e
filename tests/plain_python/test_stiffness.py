"""Stiffness of beds for small motions with every effect and in random scenes, in plain Python.

It is compared with differences of sums written out pair by pair, with differences of forces, and with
second differences of the energy.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate
from granular.linear.bed_forces import BedForces, directional_derivative
from tests.plain_python.brute_force import Bed
from tests.plain_python.test_drawn_scenes import CUT_OFF, SCENES, Case, Drawn, make_case
from tests.plain_python.test_every_effect import EXAMPLES, small

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

CLOSE = 1e-6
"""Error over the largest product of the stiffness and a direction."""
MOVED, NUDGE = 6, 2e-5
"""Grains that a direction moves: few, so that few pairs may pass the end of a cut-off; and largest shift that
keeps them off it [m]."""
APPROXIMATE = 3e-4
"""Error of the mesh's forces (`granular.pairs.pair_sum_settings.TOLERANCE`), and of the stiffness of discs:
their law is right to 9e-6, and goes over into its tables within a hundredth of a distance."""
QUICK = (0, 3, 5, 8, 14)
"""Scenes that have every feature, and each sum."""


def direction(bed: BedForces, grains: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Draw a random direction with motion of some grains, the piston and a machine."""
    result, count = np.zeros(bed.size), len(grains)
    result[grains], result[bed.grains + grains] = random.uniform(-1.0, 1.0, (2, count))
    result[2 * bed.grains :] = random.uniform(-1.0, 1.0, bed.size - 2 * bed.grains)
    return result


def check_stiffness(bed: BedForces, at: np.ndarray, along: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Compare a product with the stiffness matrix to differences of forces, and return it."""
    product = bed.stiffness_times(at, along)
    size = float(np.abs(product).max())
    turned = float(along @ bed.stiffness_times(at, other))
    assert abs(float(other @ product) - turned) < CLOSE * size * math.sqrt(len(at))
    end = bed.bodies
    height = float(bed.scene.piston.height) if bed.scene.piston is not None else None

    def found(q: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the force on grains and piston, and the energy."""
        at_height = height if bed.piston is None else float(q[bed.piston])
        one = evaluate(bed.scene, bed.positions(q), None, at_height)
        forces = [one.force.T.ravel(), [] if bed.piston is None else [one.piston_force]]
        return np.concatenate(forces), one.potential_energy

    step = bed.finite_difference_displacement(at) * bed.length
    again = -directional_derivative(lambda q: found(q)[0], at, along, 0.6 * step)
    np.testing.assert_allclose(product[:end], again, rtol=0.0, atol=CLOSE * size)
    if bed.machine is None:  # its springs store energy, too
        h = 1.6 * step / float(np.abs(along).max())
        e = [found(at + k * h * along)[1] for k in (-2, -1, 0, 1, 2)]
        curvature = (16.0 * (e[1] + e[3]) - e[0] - e[4] - 30.0 * e[2]) / (12.0 * h * h)
        noise = 100.0 * np.finfo(float).eps * abs(e[2]) / (h * h)
        assert abs(float(along @ product) - curvature) < CLOSE * size * float(np.abs(along).sum()) + noise
    return product


@pytest.mark.parametrize("name", EXAMPLES)
def test_stiffness_of_every_effect_agrees_with_second_differences_of_its_energy(name: str) -> None:
    scene = small(name)
    if name == "contact":
        start = scene.initial_positions_and_velocities()[0] * [0.62, 1.0] + [0.007, 0.0]
        scene = scene.replace(**{"arrangement.positions": start.tolist()})
    bed = BedForces(scene)
    at = bed.coordinates(scene.initial_positions_and_velocities()[0], scene.piston.height)
    random, grains = np.random.default_rng(4), np.arange(bed.grains)
    check_stiffness(bed, at, direction(bed, grains, random), direction(bed, grains, random))


def clear_of_ends(
    scene: Scene, bed: BedForces, start: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and grains that may move without crossing the cut-off of a pair sum."""
    sides, size = scene.cell.periods, scene.grains.species[0].diameter
    shorter = None if sides is None else min(sides) / size
    radius = scene.pairs.near_pair_radius(scene.pair_method, size, shorter)
    end = CUT_OFF if scene.pair_method == "verlet-list" else math.inf if radius is None else radius * size
    at, apart = start, 8.0 * bed.finite_difference_displacement(start) * bed.length
    for _ in range(1000):
        grains = random.choice(bed.grains, MOVED, replace=False)
        places = bed.positions(at)
        way = places[grains][:, None] - places
        if sides is not None:
            way -= sides * np.round(way / sides)
        if (np.abs(np.hypot(*way.T) - end) > apart).all():
            return at, grains
        at = start.copy()
        at[: 2 * bed.grains] += random.uniform(-NUDGE, NUDGE, 2 * bed.grains)
    raise AssertionError("no places are clear")


def quick_or_long(scenes: list[Drawn]) -> list[Any]:
    return [pytest.param(one, marks=() if k in QUICK else pytest.mark.long) for k, one in enumerate(scenes)]


@pytest.mark.parametrize("drawn", quick_or_long(SCENES), ids=str)
def test_stiffness_of_random_scenes_agrees_with_brute_force(drawn: Drawn) -> None:
    case = make_case(drawn)
    bed, random = BedForces(case.scene), np.random.default_rng([5, drawn.seed])
    start = bed.coordinates(case.bed.places, case.bed.piston)
    at, grains = clear_of_ends(case.scene, bed, start, random)
    along, other = direction(bed, grains, random), direction(bed, grains, random)
    product = check_stiffness(bed, at, along, other)
    written_out = directional_derivative(
        summed_forces(case, bed), at, along, 0.6 * bed.finite_difference_displacement(at) * bed.length
    )
    close = APPROXIMATE if drawn.features & {"mesh", "cylinders"} else CLOSE
    size = float(np.abs(product).max())
    np.testing.assert_allclose(product[: bed.bodies], -written_out, rtol=0.0, atol=close * size)


def summed_forces(case: Case, bed: BedForces) -> Callable[[np.ndarray], np.ndarray]:
    """Return forces on grains and piston, summed pair by pair and wall by wall."""

    def forces(q: np.ndarray) -> np.ndarray:
        height = case.bed.piston if bed.piston is None else float(q[bed.piston])
        parts = case.sums_at(moved_bed(case.bed, bed.positions(q), height)).values()
        top = [] if bed.piston is None else [math.fsum(part.walls["top"] for part in parts)]
        return np.concatenate([np.asarray(sum(part.force for part in parts)).T.ravel(), top])

    return forces


def moved_bed(bed: Bed, places: np.ndarray, piston: float | None) -> Bed:
    return dataclasses.replace(bed, places=places, piston=piston)
