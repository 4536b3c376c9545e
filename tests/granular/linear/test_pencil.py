"""Mass, damping and stiffness matrices of small motions.

Products computed without a matrix agree with products by the full matrix.
"""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from granular.effects.host_structure import Host
from granular.linear import normal_modes, piston_roots, slopes, transmissibility
from granular.linear import pencil as pencils
from granular.linear.bed_forces import BedForces, mass_stiffness_and_damping_of_chain
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.linear.pencil import Pencil, make_pencil
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, small_damper
from tests.modes import quick_in_plain_python

KEYS = ("grains.remanence", "piston.mass", "cell.width", "effects.drag.coefficient")


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    return at_rest(
        small_damper(
            **{
                "grains.count": 92,
                "cell.width": "30 D",
                "piston.height": "10 D",
                "arrangement.height": "9.5 D",
                "piston.mass": 3.75,
            }
        )
    )


def solve_by_full_matrices(
    pencil: Pencil, s: complex, right: np.ndarray, held: tuple[int, ...] = ()
) -> np.ndarray:
    free = np.delete(np.arange(pencil.bed.size), list(held))
    matrix = pencil.full_stiffness + s * pencil.full_damping + s * s * pencil.mass.toarray()
    result = np.zeros(right.shape, np.result_type(right, s))
    result[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free])
    return result


def test_krylov_solver_agrees_with_direct_solution_by_full_matrices(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = piston_roots(rest)[0]
    found = slopes(rest, KEYS, first).values
    monkeypatch.setattr(Pencil, "solve", solve_by_full_matrices)
    direct = equilibrium_from(rest.scene, rest.positions + 1e-5, rest.piston_height)
    np.testing.assert_allclose(direct.positions, rest.positions, rtol=0.0, atol=1e-7 * 0.006)
    assert direct.piston_height == pytest.approx(rest.piston_height, rel=1e-9)
    again = piston_roots(direct)[0]
    assert again.s == pytest.approx(first.s, rel=1e-7)
    assert again.mass_fraction == pytest.approx(first.mass_fraction, rel=1e-7)
    np.testing.assert_allclose(found, slopes(direct, KEYS, again).values, rtol=1e-7, atol=1e-7)


def test_lowest_modes_of_a_large_bed_agree_with_full_matrices(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    stiffness, frequencies = rest.lowest_stiffness, normal_modes(rest, 4).frequencies
    monkeypatch.setattr(pencils, "DENSE", 0)
    large = equilibrium_from(rest.scene, rest.positions, rest.piston_height)
    assert not large.pencil.has_all_modes
    np.testing.assert_allclose(large.lowest_stiffness, stiffness, rtol=1e-5)
    np.testing.assert_allclose(normal_modes(large, 4).frequencies, frequencies, rtol=1e-6)


@quick_in_plain_python
def test_contact_stiffness_is_accurate_for_a_small_overlap() -> None:
    overlap, modulus = 2e-4 * D, 1e9
    scene = small_damper(
        **{
            "grains.count": 2,
            "effects": {"contact": {"modulus": modulus, "restitution": 0.5}, "gravity": True},
            "piston": "none",
            "protocol": [{"name": "r", "kind": "hold", "duration": 1.0}],
        }
    )
    places = np.array([[0.04, 0.02], [0.04 + D - overlap, 0.02]])
    pencil = make_pencil(bed := BedForces(scene), bed.coordinates(places, None))
    spring = 4.0 / 3.0 * modulus * np.sqrt(0.25 * D)
    stiffness = 1.5 * spring * np.sqrt(overlap)
    assert pencil.full_stiffness[0, 0] == pytest.approx(stiffness, rel=1e-6)
    assert pencil.full_stiffness[0, 1] == pytest.approx(-stiffness, rel=1e-6)
    reduced, logarithm = 0.5 * scene.grains.masses()[0], np.log(0.5)
    alpha = -np.sqrt(5.0) * logarithm / np.hypot(logarithm, np.pi)
    dashpot = alpha * np.sqrt(reduced * spring) * overlap**0.25
    assert pencil.full_damping[0, 0] == pytest.approx(dashpot, rel=1e-6)
    assert pencil.full_damping[0, 1] == pytest.approx(-dashpot, rel=1e-6)


def test_a_grain_behind_a_wall_is_refused() -> None:
    rest = at_rest(small_damper())
    at = rest.pencil.at.copy()
    at[0] = -D
    with pytest.raises(InputError, match="start from a settled state"):
        rest.pencil.bed.forces(at)


BODIES = [
    {"mass": 0.5, "stiffness": 600.0, "damping": 0.4},
    {"mass": 0.4, "stiffness": 900.0, "damping": 0.3},
]
HOSTS: dict[str, dict[str, Any]] = {
    "cell": {"bodies": BODIES},
    "piston": {"mount": "piston", "bodies": BODIES, "cell_mass": 0.3},
}


@pytest.mark.parametrize("mount", HOSTS)
def test_mass_matrix_gives_the_kinetic_energy_relative_to_the_base(mount: str) -> None:
    bed = BedForces(small_damper(**{"effects.host": HOSTS[mount]}))
    speeds = np.random.default_rng(1).normal(size=bed.size)
    across, up = speeds[:12], speeds[12:24]
    piston, first, last = speeds[24:]
    masses = bed.scene.grains.masses()
    frame = last if mount == "cell" else last - piston
    energy = 0.5 * (0.5 * first**2 + 0.4 * last**2 + 0.3 * (piston + frame) ** 2)
    energy += 0.5 * float(masses @ (across**2 + (up + frame) ** 2))
    energy += 0.0 if mount == "cell" else 0.5 * 0.3 * frame**2
    assert 0.5 * speeds @ (bed.mass_matrix() @ speeds) == pytest.approx(energy, rel=1e-13)


def test_a_two_mass_chain_has_its_two_frequencies() -> None:
    masses, springs, dashpots = mass_stiffness_and_damping_of_chain(Host.from_plain(HOSTS["cell"]))
    found = eigh(springs, np.diag(masses), eigvals_only=True)
    # w^4 m1 m2 - w^2 (m1 k2 + m2 (k1 + k2)) + k1 k2 = 0
    middle, product = 0.5 * 900.0 + 0.4 * 1500.0, 0.5 * 0.4
    wanted = (middle + np.array([-1.0, 1.0]) * np.sqrt(middle**2 - 4.0 * product * 600.0 * 900.0)) / (
        2.0 * product
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    np.testing.assert_allclose(dashpots, [[0.7, -0.3], [-0.3, 0.3]])


@pytest.mark.parametrize("mount", HOSTS)
def test_all_bodies_follow_a_slowly_moving_base(mount: str) -> None:
    rest = at_rest(small_damper(**{"effects.host": HOSTS[mount]}))
    assert transmissibility(rest, np.array([1e-3]))[0] == pytest.approx(1.0, abs=1e-6)


def test_a_piston_on_a_machine_carries_the_weight_of_the_grains_and_of_a_free_cell() -> None:
    rest = at_rest(small_damper(**{"effects.host": HOSTS["piston"]}))
    weight = 9.8 * (0.3 + float(rest.scene.grains.masses().sum()))
    assert rest.pencil.bed.weight == pytest.approx(weight, rel=1e-12)
    alone = at_rest(small_damper(**{"piston.mass": 0.3}))
    # Upside down, the wall at the piston carries the same load as the bottom under a free piston with the
    # cell's mass.
    assert rest.piston_height == pytest.approx(alone.piston_height, rel=1e-9)
