"""Published measurements, each with a scene, and the page of the committed results."""

import math

import numpy as np
import pytest

from granular.scene.scene_in_natural_units import lattice_rest_height
from research.measured.__main__ import CAMPAIGN
from research.measured.measurements import (
    MEASUREMENTS,
    packing_that_lifts_raised_dipole,
    scene_of_measurement,
)


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_each_measurement_has_a_source_and_a_scene(name: str) -> None:
    """Missing values are listed, and the scene can be simulated."""
    entry = MEASUREMENTS[name]
    assert entry["read"]
    assert entry["not_read"]
    assert "doi:10." in entry["source"] or "arXiv:" in entry["source"]
    assert scene_of_measurement(name).protocol
    assert entry["source"] in CAMPAIGN.blocks(CAMPAIGN.read_committed_results())["measurements"].text


def test_the_mixture_has_the_published_weight() -> None:
    scene = scene_of_measurement("tsuchikusa")
    assert scene.piston.mass is not None
    assert scene.piston.mass * 9.8 == pytest.approx(110.0)
    assert [specy.diameter for specy in scene.grains.species] == [5e-3, 3e-3]


def test_a_crystal_at_the_computed_packing_fraction_carries_the_weight_of_a_raised_dipole() -> None:
    """The out-of-plane force, summed over dipoles in three dimensions, equals the weight."""
    scene, z = scene_of_measurement("taberlet"), 1e-5
    diameter, mass = scene.grains.species[0].diameter, float(scene.grains.masses()[0])
    a = diameter * math.sqrt(math.pi / (2.0 * math.sqrt(3.0)) / packing_that_lifts_raised_dipole(scene, z))
    i, j = np.mgrid[-60:61, -60:61]
    r = np.hypot((i + 0.5 * j) * a, math.sqrt(0.75) * j * a).ravel()
    r = r[r > 0.0]
    moment = scene.grains.magnets_in_species()[0].moment

    def energy(height: float) -> float:
        far = np.hypot(r, height)
        return float(1e-7 * moment**2 * (far**-3 - 3.0 * height**2 * far**-5).sum())

    lift = -(energy(1.01 * z) - energy(0.99 * z)) / (0.02 * z)
    assert lift == pytest.approx(9.8 * mass, rel=1e-3)


def test_page_of_measurements_shows_the_committed_results() -> None:
    """Equal dimensionless groups give equal results for five widths."""
    result = CAMPAIGN.read_committed_results()
    assert CAMPAIGN.outdated_blocks(result) == []
    by_kappa: dict[str, list[tuple[float, ...]]] = {}
    for row in result["rescaled"]:
        figures = row["rest"], row["frequency"], row["zeta"]
        by_kappa.setdefault(f"{row['kappa']:.6g}", []).append(figures)
    assert len(by_kappa) == 5
    for rows in by_kappa.values():
        assert len(rows) == 5
        assert np.allclose(rows, rows[0], rtol=1e-9, atol=0.0)
    for row in result["same magnets"]:
        lattice = lattice_rest_height(row["count"], row["width"], row["kappa"])
        assert row["rest"] * row["width"] / lattice == pytest.approx(row["over lattice"], rel=1e-9)
