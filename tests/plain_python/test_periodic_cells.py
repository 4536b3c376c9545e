"""The sums over pairs of a periodic cell in plain Python; nothing is compiled."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from granular import Scene, evaluate
from granular.schema.natural_units import Scales
from tests.granular.pairs.test_periodic import ewald_energy

pytestmark = pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="only where numba does not compile")

SIDES = np.array([20.0, 19.0])


@pytest.mark.parametrize(
    ("method", "magnets"),
    [("direct", "dipoles"), ("direct", "cylinders"), ("cut-off", "dipoles"), ("mesh", "dipoles")],
)
def test_grains_meet_images_across_the_sides(method: str, magnets: str) -> None:
    """A pair over a corner pushes itself apart as within the cell; the mesh to its tolerance."""
    radius = {} if method == "mesh" else {"cut_off": "7 D"}
    scene = Scene.from_plain(
        {
            "grains": {"count": 40, "species": [{"diameter": "6 mm"}], "magnets": magnets},
            "cell": {"width": "20 D", "height": "19 D", "sides": "periodic"},
            "effects": {"dipole": True},
            "pairs": {"method": method, **radius},
            "protocol": [{"kind": "hold", "name": "rest"}],
        }
    )
    scales = Scales.from_grains(scene.grains)
    places = scene.initial_positions_and_velocities()[0]
    inside = evaluate(scene, places)
    half = evaluate(scene, places + 0.5 * SIDES * scales.length)
    turns = np.random.default_rng(1).integers(-2, 3, places.shape)
    elsewhere = evaluate(scene, places + turns * SIDES * scales.length)
    size = abs(inside.force).max()
    np.testing.assert_allclose(elsewhere.force, inside.force, atol=1e-11 * size)
    off = 1e-3 if method == "mesh" else 1e-11
    np.testing.assert_allclose(half.force, inside.force, atol=off * size)
    assert half.potential_energy == pytest.approx(inside.potential_energy, rel=0.1 * off)
    if method == "mesh":
        wanted = ewald_energy(places / scales.length, SIDES)
        assert inside.potential_energy / scales.energy == pytest.approx(wanted, rel=3e-4)
