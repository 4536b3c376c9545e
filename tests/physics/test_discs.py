"""Beds of discs: all sums have their law, energy is conserved, and too near is refused."""

import itertools
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.disc_law import Disc, disc_energy_and_force
from granular.schema.natural_units import Scales
from granular.shared.errors import OutsideError

CONTACT = {"effects.contact": {"modulus": "20 MPa", "restitution": 0.7}}


def discs(scene: Scene, **changes: Any) -> Scene:
    walls = scene.effects.walls  # the same as of dipoles
    named = {} if walls is None else {"effects.walls": walls.to_plain()}
    return scene.replace(**{"grains.magnets": "cylinders", **named, **CONTACT, **changes})












@pytest.mark.long
def test_a_hard_impact_into_rows_of_discs_stops_the_run_with_its_remedy() -> None:
    """The packaged piston is made for four times as many discs."""
    changes = {
        "grains.count": 92,
        "cell.width": "30 D",
        "piston.height": "12 D",
        "arrangement.height": "11 D",
    }
    scene = load_scene("workshop").replace(**changes)
    with pytest.raises(OutsideError, match=r"let the piston fall from lower down \('piston\.height'"):
        simulate(scene, t_end=0.15, progress=False)
    lighter = simulate(scene.replace(**{"piston.mass": "3.75 kg"}), t_end=0.15, progress=False)
    assert np.isfinite(lighter.dataset["position"].values).all()
