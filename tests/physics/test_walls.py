"""Wall laws: energy, force, limits, and tangential force."""

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import Scene
from granular.compiled import entry
from granular.effects import wall_discs, wall_laws
from granular.effects.wall_laws import ExperimentalWall, InfiniteWall
from granular.pairs.disc_law import (
    Disc,
    disc_energy_and_force_continued_below_contact,
    pair_squared_distance_shift,
)
from granular.shared.errors import SceneError

LENGTH = 10.0


def difference(function: Callable[..., Any], *place: float, axis: int) -> float:
    """Return the derivative of a function in high precision, by mpmath."""
    with mpmath.workdps(90):
        point = [mpmath.mpf(one) for one in place]

        def along(value: Any) -> Any:
            moved = [*point]
            moved[axis] = value
            return function(*moved)

        return float(mpmath.diff(along, point[axis], h=mpmath.mpf(10) ** -30))


def slab_energy(w: Any, s: Any) -> Any:
    """Return the energy at a slab from its formula, in any precision."""
    a, b = s, LENGTH - s
    return (a / mpmath.sqrt(w * w + a * a) + b / mpmath.sqrt(w * w + b * b)) / (4 * w * w)


@settings(max_examples=150, deadline=None)
@given(w=st.floats(-4.0, 1.5).map(lambda one: 10.0**one), s=st.floats(-15.0, 25.0))
def test_force_of_a_slab_wall_is_the_negative_gradient_of_its_energy(w: float, s: float) -> None:
    """Both components are tested, above the slab and beyond its ends, also close to its line."""
    a, b = s, LENGTH - s
    with mpmath.workdps(60):
        energy = float(slab_energy(mpmath.mpf(w), mpmath.mpf(s)))
    if min(abs(a), abs(b)) < 1e-6:
        return
    assert wall_laws.slab_energy(w, a, b) == pytest.approx(energy, rel=1e-12)
    normal = -difference(slab_energy, w, s, axis=0)
    tangential = -difference(slab_energy, w, s, axis=1)
    scale = abs(wall_laws.slab_normal_force(w, a, b)) + abs(tangential)
    assert wall_laws.slab_normal_force(w, a, b) == pytest.approx(normal, rel=1e-7, abs=1e-9 * scale)
    assert wall_laws.slab_tangential_force(w, a, b) == pytest.approx(tangential, rel=1e-7, abs=1e-9 * scale)


@pytest.mark.parametrize("law", [ExperimentalWall, InfiniteWall])
@pytest.mark.parametrize("w", [0.1, 1.0, 7.0])
def test_force_and_stiffness_of_simple_wall_laws_are_derivatives_of_the_energy(law: Any, w: float) -> None:
    h = 1e-4 * w
    slope = (law.energy(None, w - h) - law.energy(None, w + h)) / (2.0 * h)
    assert law.force(None, w) == pytest.approx(slope, rel=1e-6)
    curve = (law.force(None, w - h) - law.force(None, w + h)) / (2.0 * h)
    assert law.stiffness(None, w) == pytest.approx(curve, rel=1e-6)
    speed = 0.4
    near = law.turning_point_stiffness(None, speed)
    distances = np.geomspace(0.2, 20.0, 20000)
    turn = distances[np.argmin([abs(law.energy(None, one) - 0.5 * speed**2) for one in distances])]
    assert near == pytest.approx(law.stiffness(None, turn), rel=0.01)


def test_stiffness_at_the_turning_point_of_a_grain_is_highest_at_the_end_of_a_slab_wall() -> None:
    """At the end, the energy is half the energy of an infinite wall, so that the grain comes closer to
    the wall.
    """
    speed, far = 0.4, 1e6
    distances = np.geomspace(0.2, 20.0, 20000)
    energies = [wall_laws.slab_energy(one, 0.0, far) for one in distances]
    turn = distances[np.argmin(np.abs(np.array(energies) - 0.5 * speed**2))]
    slab = wall_laws.SlabWall(np.array([0.0]), np.array([LENGTH]), True)
    found = entry(wall_laws.SlabWall.turning_point_stiffness)(slab, speed)
    assert found == pytest.approx(InfiniteWall.stiffness(None, turn), rel=0.01)


COIN, SMALL = Disc(0.5, 0.5), Disc(0.3, 0.5)


def row_sum(disc: Disc, w: float, along: float, pitch: float) -> np.ndarray:
    """Return energy, normal and tangential force of a row of discs, summed over its magnets."""
    x = along - pitch * (np.arange(-4000, 4000) + 0.5)
    r = np.hypot(x, w + COIN.radius)
    near = r < 40.0
    energy, force = np.zeros((2, len(r)))
    energy[near], force[near] = disc_energy_and_force_continued_below_contact(r[near], (disc, COIN))
    rho2 = r[~near] ** 2 - pair_squared_distance_shift(disc, COIN)
    energy[~near], force[~near] = rho2**-1.5, 3.0 * r[~near] * rho2**-2.5
    across = force * (w + COIN.radius) / r
    return 0.25 * np.array([energy.sum(), across.sum(), (force * x / r).sum()])


@pytest.mark.parametrize(("disc", "pitch"), [(COIN, 1.0), (COIN, 1.5), (SMALL, 1.0)])
def test_law_of_a_row_of_discs_equals_the_sum_over_magnets(disc: Disc, pitch: float) -> None:
    """Relative to the values at contact, errors are below 1e-7 at gaps of 0.1 D or more, and below 1e-3
    closer to the row.

    The error of the energy is always below 1e-6.
    """
    tables = wall_discs.tabulate_disc_wall((disc,), COIN, 1.0, pitch)
    touch = np.array(wall_discs.disc_row_energy_and_forces(tables, 0, disc.radius, 0.5 * pitch))[[0, 1, 1]]
    random = np.random.default_rng(3)
    for gap in (0.0, 0.02, 0.1, 0.3, 1.0, 3.0, 12.0):
        for along in random.uniform(0.0, 9.0, 3):
            found = wall_discs.disc_row_energy_and_forces(tables, 0, disc.radius + gap, along)
            off = np.abs(found - row_sum(disc, disc.radius + gap, along, pitch)) / touch
            assert (off <= (1e-7 if gap >= 0.1 else 1e-3)).all()
            assert off[0] <= 1e-6


def test_law_of_a_row_of_discs_tends_to_the_law_of_an_infinite_wall_at_large_distance() -> None:
    tables = wall_discs.tabulate_disc_wall((COIN,), COIN, 1.0, 1.5)
    for w in (20.0, 80.0):
        normal, middle = wall_discs.disc_row_energy_and_forces(tables, 0, w, 0.3)[1], w + COIN.radius
        factor = 1.0 + 2.0 * pair_squared_distance_shift(COIN, COIN) / middle**2
        assert normal * 1.5 == pytest.approx(factor * InfiniteWall.force(None, middle), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("w", [0.42, 0.53, 0.6, 1.1, 2.5])
def test_forces_of_a_row_of_discs_are_energy_derivatives_and_its_stiffness_is_an_upper_bound(
    w: float,
) -> None:
    tables, h = wall_discs.tabulate_disc_wall((COIN, SMALL), COIN, 1.0, 1.2), 2e-4
    touch, hessians = wall_discs.disc_row_energy_and_forces(tables, 0, 0.5, 0.6)[1], []
    for along in np.linspace(0.0, 1.2, 9):
        for axis in (0, 1):
            step = h * np.eye(2)[axis]
            near = [
                wall_discs.disc_row_energy_and_forces(tables, 0, *([w, along] + k * step))
                for k in (-2, -1, 1, 2)
            ]
            slope = (8.0 * (near[1][0] - near[2][0]) - near[0][0] + near[3][0]) / (12.0 * h)
            known = wall_discs.disc_row_energy_and_forces(tables, 0, w, along)[1 + axis]
            assert slope == pytest.approx(known, abs=1e-8 * touch)
            hessians.append([(near[1][k] - near[2][k]) / (2.0 * h) for k in (1, 2)])
    greatest = np.abs(np.linalg.eigvals(np.array(hessians).reshape(-1, 2, 2))).max()
    assert greatest <= wall_discs.disc_row_stiffness_bound(tables, 0, w) * (1.0 + 1e-4) <= 3.0 * greatest


def test_stiffness_at_the_turning_point_of_a_grain_is_highest_midway_between_discs_of_a_row() -> None:
    """A grain that approaches there comes closest to the row."""
    tables = wall_discs.tabulate_disc_wall((COIN,), COIN, 1.0, 1.2)
    speed = np.sqrt(2.0 * wall_discs.disc_row_energy_and_forces(tables, 0, 0.7, 0.0)[0])
    found = entry(wall_discs.DiscWall.turning_point_stiffness)(wall_discs.DiscWall(tables, None), speed)
    known = wall_discs.disc_row_stiffness_bound(tables, 0, 0.7)
    assert known * 0.999 <= found <= 1.1 * known


RIPPLE = """
pitch  gap  of a row  w^-3.5  w^-3  ripple
1 D    0    1.67      0.50    1.00  9.8 %
1 D    0.5  0.372     0.121   0.296  0.5 %
1 D    1    0.142     0.044   0.125  0.03 %
1.5 D  0    1.11      0.50    1.00  35 %
1.5 D  0.5  0.247     0.121   0.296  6.3 %
1.5 D  1    0.095     0.044   0.125  1.1 %
"""


def test_forces_of_rows_of_discs_and_other_walls_agree_with_the_documentation() -> None:
    """Mean forces [F*] and their variation along the wall are compared."""
    for line in RIPPLE.strip().splitlines()[1:]:
        pitch, gap, mean, experimental, infinite, ripple = (
            float(word) for word in line.replace("D", "").replace("%", "").split()
        )
        tables = wall_discs.tabulate_disc_wall((COIN,), COIN, 1.0, pitch)
        along = pitch * np.arange(32) / 32
        force = np.array([wall_discs.disc_row_energy_and_forces(tables, 0, 0.5 + gap, x)[1] for x in along])
        assert force.mean() == pytest.approx(mean, rel=6e-3)
        assert 50.0 * np.ptp(force) / force.mean() == pytest.approx(ripple, rel=0.1)
        assert ExperimentalWall.force(None, 1.0 + gap) == pytest.approx(experimental, rel=6e-3)
        assert InfiniteWall.force(None, 1.0 + gap) == pytest.approx(infinite, rel=6e-3)


@pytest.mark.parametrize(
    ("walls", "words"),
    [
        ({"left": "slab"}, "effects.walls.left.length: is missing"),
        ({"left": {"law": "slab", "length": -1}}, "above 0 m"),
        ({"bottom": {"law": "infinite", "length": 0.1}}, "only a slab has a length"),
        ({"bottom": "discs"}, "is required for law = 'discs'"),
        ({"bottom": {"law": "discs", "pitch": "0.9 D"}}, "is below the magnets' diameter"),
        ({"top": {"law": "slab", "gap_start": 0.1, "gap_end": 0.2}}, "of the piston cannot have a gap"),
        ({"bottom": {"law": "slab", "gap_start": 0.1}}, "only one end of the gap"),
        ({"bottom": {"law": "slab", "gap_start": 0.2, "gap_end": 0.1}}, "above gap_start"),
        ({"bottom": {"law": "experimental", "gap_start": 0.1, "gap_end": 0.2}}, "only a slab"),
    ],
)
def test_invalid_wall_parameters_are_an_error(bed: Scene, walls: dict, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        bed.replace(**{"effects.walls": walls})
    assert words in str(caught.value)
