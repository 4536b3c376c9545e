"""Falls of the piston onto simulated beds, predicted from one fall and from the scene alone."""

import itertools
import math

import pytest

from granular import PistonRecord, Scene, damper, simulate
from granular.shared.errors import InputError
from reduced_models import predict, score_drops
from reduced_models.falls.unseen_fall_scores import fall_prediction_error

D = 0.006


def mixed(small: float, mass: float) -> Scene:
    """Return a scene of grains of 6 mm and smaller ones in equal numbers."""
    sizes = {"big": D, "small": small}
    species = [{"name": name, "diameter": size, "share": 0.5} for name, size in sizes.items()]
    return damper().replace(**{"name": "mixture", "grains.species": species, "piston.mass": mass})


def fall(scene: Scene, height: float, seed: int = 1) -> PistonRecord:
    """Return three seconds of a fall. For N grains the given height [D] is multiplied by sqrt(N/368)."""
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


@pytest.mark.long
@pytest.mark.parametrize("scene", [damper(), damper(count=736), mixed(D / 2, 3.0), damper(count=92)])
def test_parameters_from_one_fall_predict_the_other_falls(scene: Scene) -> None:
    """Six parameters from a fall from 20 D predict falls from other heights and with other packings."""
    few = scene.grains.count == 92
    heights = (16.0, 22.0, 24.0, 26.0, 28.0) if few else (14.0, 16.0, 18.0, 22.0, 24.0, 26.0, 28.0)
    unseen = {f"{height:g} D": fall(scene, height) for height in heights}
    unseen |= {f"start {seed}": fall(scene, 20.0, seed) for seed in (2, 3, 4)}
    found = score_drops(fall(scene, 20.0), unseen, scene=scene)
    print(f"\n{found.table}\nscatter {found.scatter}")
    best = found.best
    assert best.name == "elastoplastic-bed"
    assert few or best.median_error <= 0.01
    assert best.greatest_error <= (max(0.03, 2.0 * max(found.scatter)) if few else 0.02)
    for other in found.rows[1:]:
        assert all(a > b for a, b in zip(other.errors, best.errors, strict=True)), other.name


BEDS = {
    f"{count} grains, {mass:g} kg, {drag:g} kg/s": damper(mass, count=count, drag=drag)
    for count, mass, drag in itertools.product((368, 736, 1472), (5.0, 7.5, 10.0), (0.1, 0.2))
}
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
@pytest.mark.parametrize("name", [*BEDS, *OTHERS])
def test_the_scene_alone_predicts_the_fall(name: str) -> None:
    """Constants of the law were fitted to falls of some of these beds; nothing is fitted for the others."""
    scene = (BEDS | OTHERS)[name]
    falls = [fall(scene, height) for height in ((17.0, 20.0, 24.0, 28.0) if name in BEDS else (20.0, 28.0))]
    errors = [fall_prediction_error(predict(scene), one, level(one)) for one in falls]
    print(f"\n{name}:", *(f"{100 * each:.2f} %" for each in errors))
    assert max(errors) <= (0.025 if name in BEDS else 0.03)


@pytest.mark.long
@pytest.mark.parametrize("name", RUBBING)
def test_errors_of_the_frictionless_law_for_grains_with_friction_are_as_documented(name: str) -> None:
    """`predict` refuses these scenes."""
    static, dynamic, *errors = RUBBING[name]
    scene = damper().replace(**{"effects.friction": {"static": static, "dynamic": dynamic}})
    with pytest.raises(InputError, match="has friction"):
        predict(scene)
    falls = [fall(scene, height) for height in (20.0, 28.0)]
    found = [fall_prediction_error(predict(damper()), one, level(one)) for one in falls]
    print(f"\n{name}:", *(f"{100 * each:.2f} %" for each in found))
    assert found == pytest.approx(errors, rel=0.1)
