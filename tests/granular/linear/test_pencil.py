"""Products of a vector and Krylov's method, in place of full matrices."""

from __future__ import annotations

import numpy as np
import pytest

from granular.linear import normal_modes, piston_roots, slopes
from granular.linear import pencil as pencils
from granular.linear.equilibrium import equilibrium_from
from tests.granular.linear.small_beds import at_rest, small_damper

KEYS = ("grains.remanence", "piston.mass", "cell.width", "effects.drag.coefficient")


def test_a_large_bed_takes_the_same_equilibrium_root_and_slopes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = small_damper(
        **{
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "10 D",
            "arrangement.height": "9.5 D",
            "piston.mass": 3.75,
        }
    )
    full = at_rest(scene)
    monkeypatch.setattr(pencils, "DENSE", 0)
    large = equilibrium_from(scene, full.positions + 1e-5, full.piston_height)
    assert full.pencil.exact
    assert not large.pencil.exact
    np.testing.assert_allclose(large.positions, full.positions, rtol=0.0, atol=1e-7 * 0.006)
    assert large.piston_height == pytest.approx(full.piston_height, rel=1e-9)
    np.testing.assert_allclose(large.lowest_stiffness, full.lowest_stiffness, rtol=1e-5)
    modes = normal_modes(large, 4).frequencies
    np.testing.assert_allclose(modes, normal_modes(full, 4).frequencies, rtol=1e-6)
    first, again = piston_roots(full)[0], piston_roots(large)[0]
    assert again.s == pytest.approx(first.s, rel=1e-7)
    assert again.mass_fraction == pytest.approx(first.mass_fraction, rel=1e-7)
    found = slopes(large, KEYS, again).values
    np.testing.assert_allclose(found, slopes(full, KEYS, first).values, rtol=1e-7, atol=1e-7)
