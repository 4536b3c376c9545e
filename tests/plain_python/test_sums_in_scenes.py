"""Sums of scenes for which nothing else need be compiled: discs by each method, forces taken apart."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from granular import load_scene, simulate
from granular.shared.errors import OutsideError
from tests.granular.observables import test_compression
from tests.physics.test_discs import NO_CONTACT, beyond_dipoles, dipoles, discs, forces, lattice

pytestmark = pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="only where numba does not compile")


@pytest.mark.parametrize(
    ("pairs", "reach", "tolerance"),
    [
        ({"method": "cut-off", "cut_off": "7 D"}, 7.0, 1e-5),
        ({"method": "mesh", "tolerance": 1e-4}, 50.0, 1e-4),
    ],
    ids=["cut-off", "mesh"],
)
def test_discs_have_their_law(pairs: dict[str, Any], reach: float, tolerance: float) -> None:
    positions = lattice(40, 10, 1.35)
    scene = load_scene("bed").replace(pairs=pairs, **{"grains.count": 40})
    known = beyond_dipoles(positions, reach)
    if pairs["method"] == "cut-off":  # there the law of dipoles is known, too
        alone = {"effects.walls": None, "effects.gravity": None, "piston": None}
        found = forces(discs(scene.replace(**alone), **NO_CONTACT), positions)
        beyond = found - dipoles(positions, reach)
    else:
        beyond = forces(discs(scene), positions) - forces(scene, positions)
    assert np.abs(beyond - known).max() <= tolerance * np.abs(known).max()


def test_forces_taken_apart_add_up(random: np.random.Generator) -> None:
    """Forces of pairs of discs, and of walls by formulas."""
    test_compression.test_the_parts_add_up_for_discs(random)
    changes = {"effects.walls": {"left": test_compression.FORMULA}, "grains.spread": 0.1}
    test_compression.test_the_parts_add_up_to_the_force_of_the_engine(changes, random)


@pytest.mark.filterwarnings("ignore")
def test_discs_pressed_into_each_other_stop_the_run() -> None:
    scene = discs(load_scene("bed"), **{"effects.contact.modulus": "1 kPa", "grains.count": 2}).replace(
        **{
            "arrangement": {
                "positions": [["10 D", "3 D"], ["11.05 D", "3 D"]],
                "velocities": [[8.0, 0.0], [-8.0, 0.0]],
            }
        }
    )
    with pytest.raises(OutsideError, match=r"0\.98 is the limit.*effects\.contact\.modulus"):
        simulate(scene, dt=2e-6, t_end=2e-4, progress=False)
