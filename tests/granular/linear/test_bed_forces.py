"""Stiffness and resistance of two grains, written down."""

import numpy as np
import pytest

from granular.linear.bed_forces import BedForces
from granular.linear.pencil import make_pencil
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, small_damper
from tests.modes import quick_in_plain_python


@quick_in_plain_python
def test_contact_keeps_its_stiffness_at_a_small_overlap() -> None:
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
    with pytest.raises(InputError, match="give a settled state"):
        rest.pencil.bed.forces(at)
