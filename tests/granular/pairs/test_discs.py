"""Force law of two magnetic discs compared with magpylib's fields, and its tables compared with the law."""

import itertools

import magpylib
import numpy as np
import pytest

from granular.compiled import entry
from granular.pairs import direct_sum as direct
from granular.pairs import near_law
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.disc_law import (
    CLOSEST,
    Disc,
    contact_distance,
    disc_energy_and_force,
    disc_energy_and_force_continued_below_contact,
    make_all_pairs_and_near_disc_laws,
    pair_squared_distance_shift,
    squared_distance_shift,
)
from granular.pairs.grain_arrays import STIFFNESS, GrainArrays
from granular.pairs.near_law import allocate_near_list_of_law
from granular.shared.errors import InputError

MU0 = 4e-7 * np.pi
COIN, SMALL, THIN, TALL = Disc(0.5, 0.5), Disc(0.35, 0.4), Disc(0.5, 0.2), Disc(0.5, 1.0)

add_near_forces = entry(near_law.add_near_forces)
measure_near_part = entry(near_law.near_energy_and_add_stiffness)
squared_collision_frequency = entry(near_law.squared_collision_frequency)
direct_sum = entry(direct.direct_sum)


def face_points(radius: float, many: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return quadrature nodes and weights on a disc, dense on the left near a possible contact."""
    t, w = np.polynomial.legendre.leggauss(many)
    angle, across = np.meshgrid(0.5 * np.pi * (t + 1.0), t, indexing="ij")
    points = np.stack([-np.cos(angle), np.sin(angle) * across], axis=-1) * radius
    weights = 0.5 * np.pi * w[:, None] * w * radius**2 * np.sin(angle) ** 2
    return points.reshape(-1, 2), weights.ravel()


def from_fields(r: float, first: Disc, second: Disc) -> tuple[float, float]:
    """Return energy and force in units of mu0 m1 m2/(4 pi), from magpylib's field in the second disc."""
    source = magpylib.magnet.Cylinder(polarization=(0, 0, 1), dimension=(2.0 * first.radius, first.height))
    points, weights = face_points(second.radius)

    def field(height: float, axis: int) -> float:
        at = np.column_stack([points + np.array([r, 0.0]), np.full(len(points), height)])
        return float(weights @ source.getB(at)[:, axis]) / MU0

    low, high = -0.5 * second.height, 0.5 * second.height
    force = field(high, 0) - field(low, 0)
    t, w = np.polynomial.legendre.leggauss(20)
    # The field is singular at the edges of the source.
    ends = np.unique(np.clip([low, -0.5 * first.height, 0.5 * first.height, high], low, high))
    energy = 0.0
    for begin, end in itertools.pairwise(ends):
        z, half = 0.5 * (begin + end) + 0.5 * (end - begin) * t, 0.5 * (end - begin)
        energy -= half * sum(weight * field(at, 2) for at, weight in zip(z, w, strict=True))
    unit = np.pi * (first.radius * second.radius) ** 2 * first.height * second.height / (4 * MU0)
    return energy / unit, force / unit


def test_disc_law_agrees_with_magpylib_fields() -> None:
    random = np.random.default_rng(51)
    for k in range(24):
        first, second = (Disc(random.uniform(0.2, 0.5), random.uniform(0.1, 0.6)) for _ in range(2))
        second = first if k % 2 else second
        contact = contact_distance(first, second)
        r = contact * (1.0 if k < 4 else 20.0 ** random.uniform())
        energy, force = disc_energy_and_force(np.array([contact, r]), first, second)
        known = from_fields(r, first, second)
        assert known[0] == pytest.approx(energy[1], rel=1e-5, abs=1e-6 * energy[0])
        assert known[1] == pytest.approx(force[1], rel=1e-6, abs=1e-8 * force[0])


@pytest.mark.parametrize("pair", [(COIN, COIN), (COIN, SMALL), (THIN, TALL)])
def test_distant_discs_interact_as_dipoles_with_the_next_multipole(pair: tuple[Disc, Disc]) -> None:
    r = np.array([60.0, 120.0])
    excess = disc_energy_and_force(r, *pair)[0] * r**3 - 1.0
    slope = (excess[0] - excess[1]) / (r[0] ** -2 - r[1] ** -2)
    assert slope == pytest.approx(1.5 * pair_squared_distance_shift(*pair), rel=3e-3, abs=1e-4)
    assert 3.0 * squared_distance_shift(COIN) == pytest.approx(2.25 * (0.25 - 0.25 / 3.0))


class Bed:
    """Disc-shaped grains, and their pair sums by direct sum and tables."""

    def __init__(self, positions: np.ndarray, discs: list[Disc]) -> None:
        self.count = len(positions)
        species = np.arange(self.count) % len(discs)
        volumes = np.array([disc.radius**2 * disc.height for disc in discs])
        self.x, self.y = pad_coordinates(positions)
        self.q = (volumes / volumes[0])[species]
        self.moments = pad_values(self.q) if len(discs) > 1 else None
        self.series, self.near = make_all_pairs_and_near_disc_laws(discs, species, self.moments)
        self.listed = allocate_near_list_of_law(self.near, self.count)

    def sums(self) -> tuple[np.ndarray, float, np.ndarray, int]:
        """Forces, energy, stiffness, and number of overlapping pairs."""
        out, extremes = np.zeros((3, self.x.size)), np.zeros(2)
        arrays = GrainArrays(
            self.x,
            self.y,
            out[0],
            out[1],
            self.moments,
            out[2],
            extremes,
            series=self.series.coefficients,
            shift=self.series.shift,
        )
        direct_sum(arrays, None, None, None)
        crowded = add_near_forces(self.near, self.listed, self.count, self.x, self.y, out[0], out[1])
        stiffness = 6.0 * self.series.coefficients[STIFFNESS] * out[2] * pad_values(self.q)
        energy = measure_near_part(self.near, self.listed, self.count, self.x, self.y, None, stiffness)
        return out[:2, : self.count].T, 0.25 * extremes[0] + energy, stiffness[: self.count], crowded


@pytest.mark.parametrize("discs", [[COIN], [COIN, SMALL], [Disc(0.5, 0.5), Disc(0.4, 0.495)], [THIN]])
def test_compiled_pair_sum_reproduces_the_disc_law_beyond_contact(discs: list[Disc]) -> None:
    """Errors are below 1e-6 of force and energy at contact, or below 1e-5 of force and energy at the same
    distance.
    """
    pair = discs[0], discs[-1]
    contact = contact_distance(*pair)
    for r in contact * np.concatenate([[1.0, 1.0001, 1.003], np.geomspace(1.01, 20.0, 60)]):
        bed = Bed(np.array([[0.0, 0.0], [0.6 * r, 0.8 * r]]), discs)
        force, energy, _, _ = bed.sums()
        exact = disc_energy_and_force(np.array([contact, r]), *pair)
        scale = 0.25 * bed.q[0] * bed.q[1]
        assert energy == pytest.approx(scale * exact[0][1], rel=1e-5, abs=1e-6 * scale * exact[0][0])
        push = force[1] @ [0.6, 0.8]
        assert push == pytest.approx(scale * exact[1][1], rel=1e-5, abs=1e-6 * scale * exact[1][0])


@pytest.mark.parametrize("discs", [[COIN], [COIN, SMALL]])
def test_disc_force_in_the_compiled_pair_sum_is_the_negative_derivative_of_the_energy(
    discs: list[Disc],
) -> None:
    """Distances below contact are included, where the force is continued linearly."""
    contact, step = contact_distance(discs[0], discs[-1]), 2e-4

    def sums(r: float) -> tuple[float, float]:
        force, energy, _, _ = Bed(np.array([[0.0, 0.0], [r, 0.0]]), discs).sums()
        return energy, force[1, 0]

    unit = sums(contact)[1]
    for r in contact * np.array([0.985, 1.01, 1.1, 1.14, 1.16, 1.5, 2.1, 2.2, 2.25, 3.0, 3.8, 5.0]):
        near, far, nearer, farther = (sums(r + k * step)[0] for k in (-1, 1, -2, 2))
        slope = (8.0 * (near - far) - (nearer - farther)) / (12.0 * step)
        assert slope == pytest.approx(sums(r)[1], abs=1e-9 * unit)
    below = [sums(contact * (1.0 - k))[1] for k in (0.004, 0.008, 0.012)]
    assert below[0] - 2.0 * below[1] + below[2] == pytest.approx(0.0, abs=1e-7 * unit)
    assert (below[1] - below[0]) / 0.004 == pytest.approx(
        (sums(contact)[1] - sums(contact * 1.0001)[1]) / 1e-4, rel=0.02
    )


def test_overlapping_discs_are_counted() -> None:
    for ratio, many in ((CLOSEST - 1e-6, 1), (CLOSEST + 1e-6, 0), (0.1, 1)):
        assert Bed(np.array([[0.0, 0.0], [ratio, 0.0]]), [COIN]).sums()[3] == many


@pytest.mark.parametrize("discs", [[COIN], [COIN, SMALL]])
def test_stiffness_of_discs_bounds_the_largest_eigenvalue_of_the_hessian_of_the_energy(
    discs: list[Disc],
) -> None:
    random = np.random.default_rng(2)
    grid = np.array([(k % 5, k // 5) for k in range(25)]) * 1.12
    positions = grid + random.uniform(-0.05, 0.05, grid.shape)
    step, columns = 1e-5, []
    for k in range(50):
        moved = [positions.copy().ravel(), positions.copy().ravel()]
        moved[0][k] += step
        moved[1][k] -= step
        forces = [Bed(flat.reshape(-1, 2), discs).sums()[0].ravel() for flat in moved]
        columns.append((forces[1] - forces[0]) / (2.0 * step))
    greatest = np.linalg.eigvalsh(0.5 * (np.array(columns) + np.array(columns).T)).max()
    bound = Bed(positions, discs).sums()[2].max()
    assert greatest <= bound <= 3.0 * greatest


@pytest.mark.parametrize("ratio", [0.985, 1.05, 1.3, 2.0, 5.0])
def test_stiffness_estimate_for_a_head_on_collision_of_discs_applies_at_the_turning_point(
    ratio: float,
) -> None:
    """Two discs of mass m, each of speed v, turn where their pair energy is m v^2; the reduced mass is
    m/2.
    """
    step = 1e-4
    energy, force = disc_energy_and_force_continued_below_contact(
        ratio + step * np.array([-1.0, 0.0, 1.0]), (COIN, COIN)
    )
    mass, moment = 0.7, 0.8
    speed = np.sqrt(0.25 * moment**2 * energy[1] / mass)
    known = 2.0 / mass * 0.25 * moment**2 * (force[0] - force[2]) / (2.0 * step)
    discs = make_all_pairs_and_near_disc_laws([COIN], np.zeros(2, dtype=np.int64), strength=moment**2 / mass)[
        1
    ]
    assert known <= squared_collision_frequency(discs, speed) * 1.01 <= 1.25 * known


def test_discs_that_are_too_tall_are_refused() -> None:
    with pytest.raises(InputError, match="discs with a height of"):
        make_all_pairs_and_near_disc_laws([Disc(0.5, 6.0)], np.zeros(1, dtype=np.int64))
