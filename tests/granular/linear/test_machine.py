"""Matrices of machines against their kinetic energy and a chain that is solved by hand."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from granular.effects.host_structure import Host
from granular.linear import transmissibility
from granular.linear.bed_forces import BedForces, matrices_of_chain
from tests.granular.linear.small_beds import at_rest, small_damper

BODIES = [
    {"mass": 0.5, "stiffness": 600.0, "damping": 0.4},
    {"mass": 0.4, "stiffness": 900.0, "damping": 0.3},
]
HOSTS: dict[str, dict[str, Any]] = {
    "cell": {"bodies": BODIES},
    "piston": {"mount": "piston", "bodies": BODIES, "cell_mass": 0.3},
}


@pytest.mark.parametrize("mount", HOSTS)
def test_the_mass_matrix_is_that_of_the_velocities_over_the_base(mount: str) -> None:
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


def test_a_chain_alone_has_its_two_frequencies() -> None:
    masses, springs, dashpots = matrices_of_chain(Host.from_plain(HOSTS["cell"]))
    found = eigh(springs, np.diag(masses), eigvals_only=True)
    # w^4 m1 m2 - w^2 (m1 k2 + m2 (k1 + k2)) + k1 k2 = 0
    middle, product = 0.5 * 900.0 + 0.4 * 1500.0, 0.5 * 0.4
    wanted = (middle + np.array([-1.0, 1.0]) * np.sqrt(middle**2 - 4.0 * product * 600.0 * 900.0)) / (
        2.0 * product
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    np.testing.assert_allclose(dashpots, [[0.7, -0.3], [-0.3, 0.3]])


@pytest.mark.parametrize("mount", HOSTS)
def test_a_slow_base_takes_all_along(mount: str) -> None:
    rest = at_rest(small_damper(**{"effects.host": HOSTS[mount]}))
    assert transmissibility(rest, np.array([1e-3]))[0] == pytest.approx(1.0, abs=1e-6)


def test_the_weight_of_a_free_cell_and_of_its_grains_rests_on_the_piston() -> None:
    rest = at_rest(small_damper(**{"effects.host": HOSTS["piston"]}))
    weight = 9.8 * (0.3 + float(rest.scene.grains.masses().sum()))
    assert rest.pencil.bed.weight == pytest.approx(weight, rel=1e-12)
    alone = at_rest(small_damper(**{"piston.mass": 0.3}))
    # Upside down, the wall at the piston bears what the bottom bears under a free piston of the cell's mass.
    assert rest.piston_height == pytest.approx(alone.piston_height, rel=1e-9)
