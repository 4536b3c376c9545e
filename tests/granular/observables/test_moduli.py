"""Elastic moduli of the dipole crystal from its lattice sum, and moduli of beds from small strains."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import fsolve

from granular import Scene, evaluate
from granular.effects.dipole import discs_unless_dipoles
from granular.observables import (
    bed_moduli,
    crystal_moduli,
    dipole_pair_strength,
    interaction_parameter,
    melting_theory_modulus,
)
from granular.observables.moduli import Moduli, hexagonal_lattice_sum, lattice_spacing
from granular.pairs.dipole_law import ENERGY
from granular.pairs.disc_law import disc_energy_and_force
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from tests.modes import quick_in_plain_python

from .conftest import hexagonal

SPACING = 0.0115
CONTACT = {"contact": {"modulus": 1e7}}
"""Modulus [Pa]."""


def scene_of(bed: Scene, count: int, **changes: object) -> Scene:
    return bed.replace(
        **{
            "grains.count": count,
            "cell.width": 2.0,
            "piston": None,
            "effects": {"dipole": True},
            "arrangement": {"height": 2.0},
            "protocol": [{"kind": "hold", "name": "rest", "duration": 1.0}],
            **changes,
        }
    )


def strength_of(scene: Scene) -> float:
    scales = Scales.from_grains(scene.grains)
    return dipole_pair_strength(scales.current * scales.length**2)


def test_lattice_sum_equals_a_direct_sum_over_a_large_disc() -> None:
    """Beyond the disc, the direct sum is continued by an integral."""
    reach = 400
    i, j = np.meshgrid(np.arange(-2 * reach, 2 * reach + 1), np.arange(-2 * reach, 2 * reach + 1))
    squares = (i * i + i * j + j * j).ravel()
    squares = squares[(squares > 0) & (squares < reach**2)]
    brute = float((squares**-1.5).sum()) + 2.0 * math.pi * 2.0 / math.sqrt(3.0) / reach
    assert hexagonal_lattice_sum() == pytest.approx(brute, rel=1e-5)


def test_moduli_of_the_dipole_crystal_follow_the_power_law_and_published_values() -> None:
    """The published Young's modulus is 1.258 Gamma T/a^2 (von Gruenberg et al., 2004)."""
    one, four = crystal_moduli(1.0, 1.0), crystal_moduli(4.0, 1.0)
    assert four.pressure / one.pressure == pytest.approx(32.0, rel=1e-12)
    step = 1e-5
    up, down = (crystal_moduli(1.0 + d, 1.0).pressure for d in (step, -step))
    assert (up - down) / (2.0 * step) == pytest.approx(one.bulk, rel=1e-8)
    # Natural units: pair energy 1/4 at a distance of 1.
    assert crystal_moduli(1.0, 0.25).pressure == pytest.approx(1.6675, rel=1e-4)
    density, temperature = 3.0, 0.02
    gamma = interaction_parameter(density, 1.0, temperature)
    found = crystal_moduli(density, 1.0)
    unit = gamma * temperature / lattice_spacing(density) ** 2
    assert found.bulk / unit == pytest.approx(3.458, abs=5e-4)
    assert found.shear / unit == pytest.approx(0.3458, abs=5e-5)
    assert melting_theory_modulus(found, density, temperature) / gamma == pytest.approx(1.258, abs=1e-3)


@pytest.mark.parametrize("reach", [3.0, 6.0, pytest.param(10.0, marks=pytest.mark.long)])
def test_moduli_measured_inside_a_crystal_patch_are_the_moduli_of_the_infinite_lattice(
    bed: Scene, reach: float
) -> None:
    points = hexagonal(int(2.0 * reach) + 10, int(2.4 * reach) + 10, SPACING)
    scene = scene_of(bed, len(points))
    found = bed_moduli(scene, points, reach)
    density = 2.0 / math.sqrt(3.0) / SPACING**2
    wanted = crystal_moduli(density, strength_of(scene))
    assert found.density == pytest.approx(density, rel=1e-9)
    for moduli in (found.affine, found.relaxed):
        np.testing.assert_allclose(moduli, wanted, rtol=5e-3)
        assert moduli.young_modulus == pytest.approx(wanted.young_modulus, rel=5e-3)


def test_affine_moduli_of_dipoles_are_proportional_to_the_pressure(
    bed: Scene, random: np.random.Generator
) -> None:
    points = SPACING * (hexagonal(11, 12) + 0.06 * random.normal(size=(132, 2)))
    points[0] = np.nan
    affine = bed_moduli(scene_of(bed, 132), points, 3.0).affine
    assert affine.bulk == pytest.approx(2.5 * affine.pressure, rel=1e-8)
    assert affine.shear == pytest.approx(0.25 * affine.pressure, rel=1e-8)


@quick_in_plain_python
def test_moduli_of_grains_in_contact_agree_with_the_energy_of_a_strained_periodic_crystal(bed: Scene) -> None:
    """The crystal of compressed grains is strained by 3e-4."""
    spacing, step = 0.97 * 0.006, 3e-4
    height = math.sqrt(3.0) * spacing

    def energy(wide: float, high: float) -> float:
        points = hexagonal(6, 6, 1.0)
        points = (points - points.min(axis=0) + 0.25) * [wide * spacing, high * spacing]
        cell = {"sides": "periodic", "width": 6.0 * wide * spacing, "height": 3.0 * high * height}
        scene = scene_of(bed, 36, effects=CONTACT, cell=cell, arrangement={"positions": points.tolist()})
        return evaluate(scene, points).potential_energy

    area, start = 18.0 * spacing * height, energy(1.0, 1.0)
    up, down = (energy(math.exp(s), math.exp(s)) for s in (step, -step))
    slope, bend = (up - down) / (2.0 * step), (up + down - 2.0 * start) / step**2
    sheared = energy(math.exp(step), math.exp(-step)) + energy(math.exp(-step), math.exp(step))
    points = hexagonal(14, 16, spacing)
    found = bed_moduli(scene_of(bed, len(points), effects=CONTACT), points, 3.0)
    shear = (sheared - 2.0 * start) / step**2
    wanted = np.array([-2.0 * slope, bend - 2.0 * slope, shear]) / (4.0 * area)
    for moduli in (found.affine, found.relaxed):
        np.testing.assert_allclose(moduli, wanted, rtol=3e-5)


@pytest.mark.long  # quick: the stiffness of discs in plain Python
def test_moduli_of_discs_agree_with_derivatives_of_their_lattice_energy(bed: Scene) -> None:
    """The energy includes discs within 30 lattice spacings, and dipoles beyond."""
    reach, step = 30, 1e-3
    i, j = np.meshgrid(np.arange(-2 * reach, 2 * reach + 1), np.arange(-2 * reach, 2 * reach + 1))
    squares, times = np.unique(i * i + i * j + j * j, return_counts=True)
    shells = (squares > 0) & (squares < reach**2)
    r, times = np.sqrt(squares[shells]), times[shells]
    points = hexagonal(22, 24, SPACING)
    scene = scene_of(bed, len(points), **{"grains.magnets": "cylinders"})
    scales = Scales.from_grains(scene.grains)
    (disc,) = discs_unless_dipoles(scene.grains, scales.length)
    unit = SPACING / scales.length

    def energy(stretch: float) -> float:
        beyond = 2.0 * math.pi * 2.0 / math.sqrt(3.0) / reach / (stretch * unit) ** 3
        total = float(times @ disc_energy_and_force(stretch * unit * r, disc, disc)[0]) + beyond
        return 0.5 * scales.force * scales.length * ENERGY * total

    start, up, down = energy(1.0), energy(math.exp(step)), energy(math.exp(-step))
    slope, bend = (up - down) / (2.0 * step), (up + down - 2.0 * start) / step**2
    found = bed_moduli(scene, points).affine
    density = 2.0 / math.sqrt(3.0) / SPACING**2
    assert found.pressure == pytest.approx(-0.5 * slope * density, rel=1e-3)
    assert found.bulk == pytest.approx((bend - 2.0 * slope) / 4.0 * density, rel=1e-3)
    assert found.bulk > 2.51 * found.pressure


def test_relaxed_moduli_agree_with_numerical_energy_minimisation_after_a_shear(
    bed: Scene, random: np.random.Generator
) -> None:
    """The energy is minimised for the inner grains, with the initial residual forces as external forces."""
    points = SPACING * (hexagonal(11, 12) + 0.06 * random.normal(size=(132, 2)))
    scene = scene_of(bed, 132)
    reach = 3.0
    found = bed_moduli(scene, points, reach)
    assert found.relaxed.shear < 0.99 * found.affine.shear
    from granular.observables.moduli import _interior_grains_area_and_reach, _smooth_cut_off_weight

    inner, area, length = _interior_grains_area_and_reach(points, reach)
    scaled, reach = points / length, 1.0
    far = ~np.eye(132, dtype=bool)
    gaps = np.linalg.norm(scaled[:, None] - scaled[None], axis=2)
    weight = np.where(far, _smooth_cut_off_weight(gaps, reach), 0.0)

    def energy(places: np.ndarray) -> float:
        gap = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(132)
        return 0.5 * float((weight / gap**3).sum())

    def slope(places: np.ndarray) -> np.ndarray:
        arm = places[:, None] - places[None]
        gap = np.linalg.norm(arm, axis=2) + np.eye(132)
        return -3.0 * ((weight / gap**5)[:, :, None] * arm).sum(axis=1)

    held, step, losses = slope(scaled)[inner], 1e-4, []
    for shear in (np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])):
        started = scaled @ (np.eye(2) + step * shear)

        def at(moves: np.ndarray, started: np.ndarray = started) -> np.ndarray:
            places = started.copy()
            places[inner] += step * moves.reshape(-1, 2)
            return places

        def unbalanced_energy_error(moves: np.ndarray, at: Callable[..., np.ndarray] = at) -> np.ndarray:
            return np.asarray((slope(at(moves))[inner] - held).ravel() / step)

        moves = fsolve(unbalanced_energy_error, np.zeros(2 * len(inner)), xtol=1e-10)
        assert (
            abs(unbalanced_energy_error(moves)).max() < 1e-4 * abs(unbalanced_energy_error(0.0 * moves)).max()
        )
        gain = energy(started) - energy(at(moves)) + step * float((held.ravel() * moves).sum())
        losses.append(gain / step**2 / 2.0)
    lost = np.mean(losses) * strength_of(scene) / length**3 / area
    assert found.affine.shear - found.relaxed.shear == pytest.approx(lost, rel=0.02)


def test_moduli_of_invalid_input_are_refused(bed: Scene) -> None:
    points = hexagonal(6, 6, SPACING)
    with pytest.raises(InputError, match="larger bed"):
        bed_moduli(scene_of(bed, 36), points)
    with pytest.raises(InputError, match="pass one position for each grain"):
        bed_moduli(scene_of(bed, 30), points)
    with pytest.raises(InputError, match="density = -1 must be above 0"):
        crystal_moduli(-1.0, 1.0)
    with pytest.raises(InputError, match="temperature = 0"):
        melting_theory_modulus(Moduli(1.0, 1.0, 1.0), 1.0, 0.0)
    with pytest.raises(InputError, match=r"bulk \+ shear modulus = 0"):
        melting_theory_modulus(Moduli(1.0, 1.0, -1.0), 1.0, 1.0)
