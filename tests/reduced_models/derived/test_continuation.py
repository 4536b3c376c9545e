"""Equilibria under a held piston, up to the height at which grains rearrange."""

from __future__ import annotations

import numpy as np
import pytest

from granular import Scene, damper, equilibrium
from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium, find_equilibrium
from reduced_models import derive
from reduced_models.derived.polynomial_law import RESOLUTION, follow_piston

DIAMETER = 6e-3  # [m]


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    """Equilibrium of 30 grains of two sizes, which rearrange if they are compressed by 0.7 D."""
    plain = damper(count=30, drop=26.0, drag=1.0, seed=2).to_plain()
    plain["grains"]["species"] = [
        {"name": "grain", "diameter": DIAMETER, "share": 0.5},
        {"name": "small", "diameter": 0.7 * DIAMETER, "share": 0.5},
    ]
    plain["protocol"] = [{"kind": "free", "name": "drop", "until": "rest", "window": 0.3}]
    plain["output"]["record"] = "drop"
    return equilibrium(Scene.from_plain(plain))


def follow(rest: Equilibrium, step: float, count: int):
    pencil = rest.pencil
    return follow_piston(pencil, pencil.bed.piston, piston_roots(rest)[0].s, step, count)


@pytest.fixture(scope="module")
def followed(rest):
    return follow(rest, -1.5e-4, 40)


def test_instability_is_where_an_eigenvalue_vanishes(rest, followed) -> None:
    states, found = followed
    assert found is not None
    assert 0.0 < states[-1].height - found.height < 1.5e-4
    _, finer = follow(rest, -5e-5, 120)
    assert finer.height == pytest.approx(found.height, abs=3.0 * RESOLUTION * DIAMETER)
    assert set(finer.grains) == set(found.grains)
    assert finer.force_drop == pytest.approx(found.force_drop, rel=0.01)
    assert found.force_drop > 0.1


def test_eigenvalue_falls_to_zero_like_a_fold(rest, followed) -> None:
    """About a fold the lowest eigenvalue goes as the root of the distance to it."""
    _, found = followed
    bed, piston = rest.pencil.bed, rest.pencil.bed.piston
    pencil, lowest = rest.pencil, []
    distances = np.array([1e-4, 2.5e-5])
    goals = found.height + distances
    for height in (*np.linspace(pencil.at[piston], goals[0], 40)[1:], goals[1]):
        start = pencil.at.copy()
        start[piston] = height
        pencil = find_equilibrium(bed, start, (piston,))
        lowest.append(pencil.lowest_modes(1, (piston,))[0][0])
    assert lowest[-2] / lowest[-1] == pytest.approx(2.0, rel=0.15)


def test_range_is_cut_at_the_instability_and_printed(rest) -> None:
    model = derive(rest.scene, 5e-3, order=9)
    (found,) = model.instabilities
    assert model.domain["height"][0] > found.height
    printed = " ".join(str(model).split())
    assert f"the range ends at {1e3 * found.height:.5g} mm" in printed
    assert f"drops by {found.force_drop:.3g} N" in printed
