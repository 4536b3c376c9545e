"""Sums of scenes for which nothing else need be compiled: discs by each method, forces taken apart."""

from typing import Any

import numpy as np
import pytest

from granular import load_scene, simulate
from granular.shared.errors import OutsideError
from tests.granular.observables.test_compression import CHANGES, check_parts
from tests.physics.test_discs import discs


@pytest.mark.parametrize("changes", CHANGES[1:], ids=str)
def test_forces_taken_apart_add_up(changes: dict[str, Any], random: np.random.Generator) -> None:
    check_parts(changes, random)


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
