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

DISCS: dict[str, Any] = {
    "grains.magnets": "cylinders",
    **{f"effects.{name}": None for name in ("gravity", "drag", "contact")},
}


def loads(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Normal loads at these positions [D], over F*."""
    scales = Scales.from_grains(scene.grains)
    return np.asarray(evaluate(scene, positions * scales.length).normal_load / scales.force)








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


