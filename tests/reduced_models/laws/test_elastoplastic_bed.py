"""A bed that yields: its small swing, the work of its loop, and falls that it was not fitted to."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from granular import PistonRecord, Scene, damper, simulate
from reduced_models import ReducedModel, fit
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.small_swing import SmallSwing, small_swing
from reduced_models.laws.solution import solution

LAW = LAWS["elastoplastic-bed"]
TRUE = {
    "lam": 0.02, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.3, "strength": 0.05,
}  # fmt: skip
D = 0.006
G = 9.8


def values(**changes: float) -> list[float]:
    return [(TRUE | changes)[name] for name in LAW.parameters]


def test_a_small_swing_feels_pressure_and_shear() -> None:
    found = small_swing(LAW, values(), 0.06)
    assert isinstance(found, SmallSwing)
    omega = math.sqrt(9.8 * (2.5 + 0.3) / 0.06)
    assert found.z == pytest.approx(0.06, rel=1e-9)
    assert found.period == pytest.approx(2.0 * math.pi / omega, rel=1e-9)
    assert found.damping_ratio == pytest.approx(0.02 / omega, rel=1e-6)


def test_without_a_modulus_it_is_the_power_law_spring() -> None:
    time = np.linspace(0.0, 2.0, 400)
    spring = LAWS["power-law-spring"]
    plain = solution(spring, time, 0.08, 0.0, [TRUE[name] for name in spring.parameters], 0.02)
    soft = solution(LAW, time, 0.08, 0.0, values(modulus=1e-12), 0.02)
    np.testing.assert_allclose(soft.z, plain.z, rtol=1e-7)


def test_shear_stress_stops_at_the_strength_and_takes_energy() -> None:
    """Large swings die out by yielding alone; small ones hardly, since they do not yield."""
    time = np.linspace(0.0, 3.0, 3000)
    far = solution(LAW, time, 0.09, 0.0, values(lam=1e-9), 0.02).z
    near = solution(LAW, time, 0.0603, 0.0, values(lam=1e-9), 0.02).z
    kept = [np.ptp(one[-600:]) / np.ptp(one[:600]) for one in (far, near)]
    assert kept[0] < 0.5
    assert kept[1] > 0.95


def fall(scene: Scene, height: float, seed: int) -> PistonRecord:
    """Three seconds after the piston is let go at a height [D]."""
    changes = {
        "piston.height": height * D, "arrangement.height": (height - 1.0) * D,
        "arrangement.seed": seed, "output.record": "drop",
        "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}],
    }  # fmt: skip
    return simulate(scene.replace(**changes), dt="auto*2", progress=False).piston()


def error(model: ReducedModel, record: PistonRecord) -> float:
    """Of the fall that the model predicts from the height alone, over the fall's height."""
    assert model.at_rest is not None
    first = float(record.height[0])
    predicted = model.simulate(record.time, z0=first, v0=0.0)
    missed = float(np.sqrt(np.mean((predicted.height - record.height) ** 2)))
    return missed / (first - model.at_rest.height)


@pytest.mark.long
def test_one_fall_tells_the_others() -> None:
    """Three numbers from a fall from 20 D; heights and starts that no fit has seen."""
    scene = damper()
    drag = scene.grains.count * 0.1 / (6.0 * 7.5)
    seen = fall(scene, 20.0, 1)
    start = {"height": float(seen.height[0]), "velocity": 0.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bed = fit(
            seen, LAW, fix={"lam": drag, "weight": G, "power": 2.5}, initial=start,
            start={"modulus": 0.3, "strength": 0.05},
        )  # fmt: skip
        rivals = [fit(seen, name, initial=start) for name in ("power-law-spring", "linear")]
    heights = (14.0, 16.0, 18.0, 22.0, 24.0, 26.0, 28.0)
    unseen = [fall(scene, height, 1) for height in heights]
    unseen += [fall(scene, 20.0, seed) for seed in (2, 3, 4)]
    errors = [error(bed, one) for one in unseen]
    print({height: f"{100 * one:.2f} %" for height, one in zip(heights, errors, strict=False)})
    assert np.median(errors) < 0.01
    assert max(errors) < 0.02
    for rival in rivals:
        assert all(error(rival, one) > mine for one, mine in zip(unseen, errors, strict=True))
