"""Beds of disc magnets: normal load of discs on the plates, and an impact that is too hard."""

from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate
from granular.pairs.disc_law import Disc, disc_torque_over_dipoles
from granular.schema.natural_units import Scales
from granular.shared.errors import OutsideError
from tests.modes import quick_in_plain_python

CONTACT = {"effects.contact": {"modulus": "20 MPa", "restitution": 0.7}}


def discs(scene: Scene, **changes: Any) -> Scene:
    walls = scene.effects.walls  # the same as of dipoles
    named = {} if walls is None else {"effects.walls": walls.to_plain()}
    return scene.replace(**{"grains.magnets": "cylinders", **named, **CONTACT, **changes})


@pytest.mark.long
def test_error_for_an_impact_that_pushes_discs_through_a_wall_recommends_a_lower_fall() -> None:
    """The packaged piston is too heavy here, since it is designed for four times as many discs."""
    changes = {
        "grains.count": 92,
        "cell.width": "30 D",
        "piston.height": "12 D",
        "arrangement.height": "11 D",
    }
    scene = load_scene("workshop").replace(**changes)
    with pytest.raises(OutsideError, match=r"let the piston fall from a smaller height \('piston\.height'"):
        simulate(scene, t_end=0.15, progress=False)
    lighter = simulate(scene.replace(**{"piston.mass": "3.75 kg"}), t_end=0.15, progress=False)
    assert np.isfinite(lighter.dataset["position"].values).all()


DISCS: dict[str, Any] = {
    "grains.magnets": "cylinders",
    **{f"effects.{name}": None for name in ("gravity", "drag", "contact")},
}


def loads(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Return the normal loads of grains at positions [D], in units of F*."""
    scales = Scales.from_grains(scene.grains)
    return np.asarray(evaluate(scene, positions * scales.length).normal_load / scales.force)


@quick_in_plain_python
def test_normal_load_of_two_discs_agrees_with_their_torque(bed: Scene) -> None:
    """Below contact, the torque at contact is used.

    The reference for dipoles is K on the page of the physical model.
    """
    scene = bed.replace(**DISCS).replace(**{"effects.friction": {}, "grains.count": 2})
    coin = Disc(0.5, 0.5)
    for r in (0.985, 1.0, 1.0005, 1.05, 1.1, 1.2, 1.375, 1.6, 2.0, 2.1, 2.14, 2.2, 3.0, 6.0):
        ratio = disc_torque_over_dipoles(np.array([max(r, 1.0)]), coin, coin)[0]
        known = 0.0126585 * ratio / max(r, 1.0) ** 3
        load = loads(scene, np.array([[20.0, 9.0], [20.0 + 0.6 * r, 9.0 + 0.8 * r]]))
        assert load == pytest.approx([known, known], rel=1e-3, abs=1e-4 * 0.0126585 * 5.35)
