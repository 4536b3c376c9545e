"""Falls of simulated beds, told by one fall, and by the scene alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from granular import PistonRecord, Scene, damper, simulate
from granular.shared.errors import InputError
from reduced_models import predict, score_drops
from reduced_models.falls.unseen_fall_scores import DropScores, fall_prediction_error

D = 0.006
SEED = 1
MIXTURE = damper().replace(
    **{
        "name": "mixture",
        "grains.species": [
            {"name": "big", "diameter": D, "share": 0.5},
            {"name": "small", "diameter": D / 2, "share": 0.5},
        ],
        "piston.mass": 3.0,
    }
)


def fall(scene: Scene, height: float, seed: int = SEED) -> PistonRecord:
    """Three seconds from a height [D], times the square root of the grains over 368."""
    scale = math.sqrt(scene.grains.count / 368)
    changes = {
        "piston.height": height * scale * D,
        "arrangement.height": (height - 1.0) * scale * D,
        "arrangement.seed": seed,
        "output.record": "drop",
        "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}],
    }
    return simulate(scene.replace(**changes), dt="auto*2", progress=False).piston()


def level(record: PistonRecord) -> float:
    return float(record.height[-len(record) // 10 :].mean())


def judged(scene: Scene, heights: Sequence[float]) -> DropScores:
    unseen = {f"{height:g} D": fall(scene, height) for height in heights}
    unseen |= {f"start {seed}": fall(scene, 20.0, seed) for seed in (2, 3, 4)}
    return score_drops(fall(scene, 20.0), unseen, scene=scene)


HEIGHTS = (14.0, 16.0, 18.0, 22.0, 24.0, 26.0, 28.0)


@pytest.mark.long
@pytest.mark.parametrize("scene", [damper(), damper(count=736), MIXTURE], ids=lambda one: str(one.name))
def test_one_fall_tells_the_others(scene: Scene) -> None:
    """Six numbers from a fall from 20 D; heights and starts that no fit has seen."""
    found = judged(scene, HEIGHTS)
    print(f"\n{found.table}\nscatter {found.scatter}")
    best = found.best
    assert best.name == "elastoplastic-bed"
    assert best.median_error <= 0.01
    assert best.greatest_error <= 0.02
    for other in found.rows[1:]:
        assert all(a > b for a, b in zip(other.errors, best.errors, strict=True)), other.name


@pytest.mark.long
def test_one_fall_of_few_grains_tells_the_others() -> None:
    """Layers of 92 grains slip one by one: starts differ by as much as the law errs."""
    found = judged(damper(count=92), (16.0, 22.0, 24.0, 26.0, 28.0))
    print(f"\n{found.table}\nscatter {found.scatter}")
    best = found.best
    assert best.name == "elastoplastic-bed"
    assert best.greatest_error <= max(0.03, 2.0 * max(found.scatter))
    for other in found.rows[1:]:
        assert all(a > b for a, b in zip(other.errors, best.errors, strict=True)), other.name


@pytest.mark.long
@pytest.mark.parametrize("count", [368, 736, 1472])
def test_the_scene_alone_tells_the_fall(count: int) -> None:
    """Nothing fitted; shear modulus and strength come from beds of other sizes."""
    worst = []
    for mass in (5.0, 7.5, 10.0):
        for drag in (0.1, 0.2):
            scene = damper(mass, count=count, drag=drag)
            law = predict(scene)
            errors = []
            for height in (17.0, 20.0, 24.0, 28.0):
                one = fall(scene, height)
                errors.append(fall_prediction_error(law, one, level(one)))
            print(
                f"{count} grains, {mass:g} kg, {drag:g} kg/s:",
                *(f"{100 * each:.2f} %" for each in np.array(errors)),
            )
            worst.append(max(errors))
    assert max(worst) <= 0.025


def mixed(small: float, mass: float) -> Scene:
    """Grains of 6 mm and smaller ones, 1:1."""
    species = [
        {"name": "big", "diameter": D, "share": 0.5},
        {"name": "small", "diameter": small, "share": 0.5},
    ]
    return damper().replace(**{"grains.species": species, "piston.mass": mass})


OTHERS = {
    "0.05 kg/s": damper(drag=0.05),
    "0.4 kg/s": damper(drag=0.4),
    "1 kg/s": damper(drag=1.0),
    "15 kg": damper(15.0),
    "48 D wide": damper().replace(**{"cell.width": 48 * D}),
    "75 D wide": damper().replace(**{"cell.width": 75 * D}),
    "6 and 3 mm, 3 kg": mixed(0.5 * D, 3.0),
    "6 and 4.5 mm, 5 kg": mixed(0.75 * D, 5.0),
    "friction of the piston, 1 N": damper().replace(**{"piston.friction": 1.0}),
    "friction of the piston, 5 N": damper().replace(**{"piston.friction": 5.0}),
}
RUBBING = {
    "friction of the grains, 0.05": (0.05, 0.05, 0.027, 0.017),
    "friction of the grains, 0.6 and 0.45": (0.6, 0.45, 0.107, 0.093),
}
"""Static and dynamic coefficient, and errors of falls from 20 and 28 D."""


@pytest.mark.long
@pytest.mark.parametrize("name", OTHERS)
def test_the_scene_alone_tells_other_beds(name: str) -> None:
    """Drags, masses, widths and mixtures on which no number was fitted."""
    scene = OTHERS[name]
    law = predict(scene)
    falls = {height: fall(scene, height) for height in (20.0, 28.0)}
    errors = [fall_prediction_error(law, one, level(one)) for one in falls.values()]
    first, other = falls[20.0].height, fall(scene, 20.0, 2).height
    scatter = float(np.sqrt(np.mean((first - other) ** 2)) / (first[0] - level(falls[20.0])))
    print(f"\n{name}:", *(f"{100 * each:.2f} %" for each in errors), f"scatter {100 * scatter:.2f} %")
    assert max(errors) <= 0.03


@pytest.mark.long
@pytest.mark.parametrize("name", RUBBING)
def test_friction_of_the_grains_is_told_so_badly(name: str) -> None:
    """By the law without friction; `predict` refuses these scenes."""
    static, dynamic, *errors = RUBBING[name]
    scene = damper().replace(**{"effects.friction": {"static": static, "dynamic": dynamic}})
    with pytest.raises(InputError, match="has friction"):
        predict(scene)
    law = predict(damper())
    falls = [fall(scene, height) for height in (20.0, 28.0)]
    found = [fall_prediction_error(law, one, level(one)) for one in falls]
    print(f"\n{name}:", *(f"{100 * each:.2f} %" for each in found))
    assert found == pytest.approx(errors, rel=0.1)
