"""The load of discs on the plates, against the torques of all pairs in plain Python."""

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from granular import Scene, evaluate
from granular.effects.dipole import discs_unless_dipoles
from granular.pairs.disc_law import Disc, contact_distance, disc_load, disc_torque_over_dipoles
from granular.schema.natural_units import Scales
from tests.modes import quick_in_plain_python
from tests.physics.test_discs import lattice

SPECIES = [
    {"name": "disc", "diameter": "6 mm", "share": 0.5},
    {"name": "flat", "diameter": "4 mm", "thickness": "2.9 mm", "remanence": "1.1 T", "share": 0.5},
]
DISCS: dict[str, Any] = {
    "grains.magnets": "cylinders",
    **{f"effects.{name}": None for name in ("gravity", "drag", "contact")},
}


def loads(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Normal loads at these positions [D], over F*."""
    scales = Scales.from_grains(scene.grains)
    return np.asarray(evaluate(scene, positions * scales.length).normal_load / scales.force)


def loads_by_torques(
    scene: Scene, positions: np.ndarray, reach: float = np.inf, periods: tuple[float, float] | None = None
) -> np.ndarray:
    """Sum over all pairs of the dipoles' load times the torque of discs over the dipoles'."""
    grains = scene.grains
    kind, shapes = grains.species_indices(), discs_unless_dipoles(grains, Scales.from_grains(grains).length)
    friction = scene.effects.friction
    assert friction is not None
    own, weight = (
        values[kind] * grains.moment_spread_factors()
        for values in friction.normal_force_factors(grains, scene.cell)
    )
    apart = positions[:, None] - positions
    if periods is not None:
        apart -= np.array(periods) * np.round(apart / np.array(periods))
    r = np.hypot(*np.moveaxis(apart, 2, 0))
    np.fill_diagonal(r, np.inf)
    law = np.zeros_like(r)
    for first, second in itertools.product(range(len(shapes)), repeat=2):
        grid = np.geomspace(contact_distance(shapes[first], shapes[second]), 100.0, 2000)
        spline = CubicSpline(grid, disc_load(grid, shapes[first], shapes[second]))
        chosen = (kind[:, None] == first) & (kind == second) & (r < reach) & (r < 100.0)
        law[chosen] = spline(r[chosen])
    total = law @ weight
    return np.asarray(own * total)


@pytest.mark.parametrize(
    ("method", "count", "tolerance"),
    [("direct", 92, 2e-4), pytest.param("mesh", 368, 6e-4, marks=pytest.mark.long)],
)
@quick_in_plain_python
def test_loads_are_sums_of_torques(bed: Scene, method: str, count: int, tolerance: float) -> None:
    """A bed of two species at rest, 1.375 D from grain to grain, with moments that scatter."""
    scene = bed.replace(**DISCS, pairs={"method": method}).replace(
        **{"effects.friction": {}, "grains.count": count, "grains.species": SPECIES, "grains.spread": 0.05}
    )
    positions = lattice(count, 40 if count > 100 else 20, 1.375)
    known = loads_by_torques(scene, positions)
    np.testing.assert_allclose(loads(scene, positions), known, rtol=tolerance)


@pytest.mark.long  # quick: drawn scenes in plain Python
def test_equal_discs_have_the_loads_of_their_torques(bed: Scene) -> None:
    """By the mesh, where the loads of dipoles come with the forces."""
    scene = bed.replace(**DISCS, pairs={"method": "mesh"}).replace(
        **{"effects.friction": {"tilt": "aligned"}, "grains.count": 368}
    )
    positions = lattice(368, 40, 1.375)
    np.testing.assert_allclose(loads(scene, positions), loads_by_torques(scene, positions), rtol=2e-4)


@quick_in_plain_python
def test_two_discs_have_the_load_of_their_torque(bed: Scene) -> None:
    """From contact on; below it the torque at contact. K of the model page for the dipoles."""
    scene = bed.replace(**DISCS).replace(**{"effects.friction": {}, "grains.count": 2})
    coin = Disc(0.5, 0.5)
    for r in (0.985, 1.0, 1.0005, 1.05, 1.1, 1.2, 1.375, 1.6, 2.0, 2.1, 2.14, 2.2, 3.0, 6.0):
        ratio = disc_torque_over_dipoles(np.array([max(r, 1.0)]), coin, coin)[0]
        known = 0.0126585 * ratio / max(r, 1.0) ** 3
        load = loads(scene, np.array([[20.0, 9.0], [20.0 + 0.6 * r, 9.0 + 0.8 * r]]))
        assert load == pytest.approx([known, known], rel=1e-3, abs=1e-4 * 0.0126585 * 5.35)


@pytest.mark.long
def test_loads_in_a_periodic_cell_are_sums_of_torques() -> None:
    """To the nearest image of each, within half a side."""
    scene = Scene.from_plain(
        {
            "name": "cell",
            "grains": {
                "count": 100,
                "magnets": "cylinders",
                "species": [{"name": "disc", "diameter": "6 mm"}],
            },
            "cell": {"width": "14 D", "height": "14 D", "sides": "periodic"},
            "effects": {"dipole": {}, "friction": {}},
            "pairs": {"method": "direct"},
            "protocol": [{"name": "hold", "kind": "hold", "duration": 1.0}],
        }
    )
    positions = lattice(100, 10, 1.4)
    known = loads_by_torques(scene, positions, 7.0, (14.0, 14.0))
    np.testing.assert_allclose(loads(scene, positions), known, rtol=2e-4)
