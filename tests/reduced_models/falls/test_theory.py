"""What a scene says of its fall: the lattice's pressure and what follows, or why nothing is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint

from granular import damper, load_scene, simulate
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from reduced_models import predict, valid_shaking_range, whole_fall
from reduced_models.falls.predicted_law import (
    POWER,
    PRESSURE,
    WEIGHT,
    OutsideRangeWarning,
    PredictedLaw,
    predict_bed_parameters,
)
from reduced_models.falls.unseen_fall_scores import fall_prediction_error
from reduced_models.laws.equation import compile_rates


def test_pressure_is_that_of_the_hexagonal_lattice() -> None:
    """Energy of a grain: half the sum of F* D (D/r)^3/4; pressure: minus its slope by the area."""
    cut = 400
    i, j = np.meshgrid(np.arange(-cut, cut + 1), np.arange(-cut, cut + 1))
    squares = (i * i + i * j + j * j).astype(float)
    inside = (squares > 0.0) & (squares < (0.8 * cut) ** 2)
    tail = 2.0 * math.pi / (math.sqrt(0.75) * 0.8 * cut)  # what lies farther off, as a continuum
    total = float((squares[inside] ** -1.5).sum()) + tail
    # At the density rho the spacing a has (D/a)^2 = sqrt(3/4) rho.
    energy = 0.125 * total * 0.75**0.75
    assert 1.5 * energy == pytest.approx(PRESSURE, rel=3e-5)
    assert POWER == 1.5 + 1.0


def test_weight_and_pressure_balance_at_rest() -> None:
    """In a bed so large that walls do not count, the lattice's pressure carries the piston."""
    scene = damper(count=10**6, drag=1e-4)
    values = predict_bed_parameters(scene)
    assert scene.piston is not None
    scales, width = Scales.from_grains(scene.grains), scene.cell.width
    density = scene.grains.count * scales.length**2 / (width * values["rest"])
    pressure = PRESSURE * scales.force / scales.length * density**POWER
    weight = scene.piston.mass * 9.8 / width
    assert pressure == pytest.approx(weight, rel=0.12)  # walls and rest by what was measured
    # Whatever mass seems to move, weight and affine drag act on the same.
    affine = 1e6 * 1e-4 / 6.0 / (scene.piston.mass * 9.8)
    assert values["lam"] / values["weight"] == pytest.approx(affine, rel=0.06)


def test_grains_add_a_third_of_their_mass_and_a_late_bed_takes_mass_away() -> None:
    scene = damper(count=1000)
    assert scene.piston is not None
    mass = scene.piston.mass
    grains = 1000 * Scales.from_grains(scene.grains).mass / 3.0
    loose, damped = (predict_bed_parameters(damper(count=1000, drag=drag))["weight"] for drag in (1e-9, 0.2))
    assert loose == pytest.approx(WEIGHT * 9.8 * mass / (mass + grains), rel=1e-6)
    assert damped > loose


def test_the_law_stands_for_falls_of_the_packaged_damper() -> None:
    """Little mass is missing there, and little added."""
    assert predict_bed_parameters(damper())["weight"] == pytest.approx(9.8, rel=0.06)


def test_a_mixture_of_equals_is_the_bed_itself() -> None:
    plain = damper()
    (one,) = plain.grains.species
    halves = [{**one.to_plain(), "name": name, "share": 0.5} for name in ("a", "b")]
    mixed = plain.replace(**{"grains.species": halves})
    assert predict_bed_parameters(mixed) == pytest.approx(predict_bed_parameters(plain))


def test_discs_rest_higher_and_are_stiffer() -> None:
    """The packaged damper of discs as simulated: 63.5 mm for 59.1, 0.2845 s for 0.2880."""
    walls = {f"effects.walls.{side}.law": "experimental" for side in ("left", "right", "bottom", "top")}
    bed = damper().replace(**{"effects.contact": {"modulus": "1 GPa"}, **walls})
    rests = [predict(bed.replace(**{"grains.magnets": m})).at_rest for m in ("dipoles", "cylinders")]
    dipoles, discs = (rest for rest in rests if rest is not None)
    assert discs.height / dipoles.height == pytest.approx(1.074, abs=0.012)
    assert discs.period / dipoles.period == pytest.approx(0.988, abs=0.012)
    assert predict(bed).parameters == pytest.approx(predict(damper()).parameters)


def test_discs_between_rows_of_discs_move_more_slowly() -> None:
    """Simulated from 20 D under 7.5 kg, two starts: 64.4 and 62.7 mm, 3.25 and 3.33 Hz (0.1 kg/s)."""
    rest = predict(damper(magnets="cylinders")).at_rest
    assert rest is not None
    assert rest.height == pytest.approx(0.0636, rel=0.015)
    assert 1.0 / rest.period == pytest.approx(3.29, rel=0.03)


FALLS = [(5.0, 18), (5.0, 20), (5.0, 24), (7.5, 18), (7.5, 20), (7.5, 24)]


@pytest.mark.long
@pytest.mark.parametrize(("mass", "height"), FALLS)
def test_falls_of_discs_are_as_predicted(mass: float, height: int) -> None:
    """Nothing fitted: the root mean square over the whole fall is within 3 % of the drop."""
    stage = {"kind": "free", "name": "drop", "duration": 3.0}
    scene = damper(mass, drop=height, magnets="cylinders").replace(
        **{"output.record": None}, protocol=[stage]
    )
    fall, law = simulate(scene, dt="auto*2", progress=False).piston(), predict(scene)
    level = float(fall.height[-len(fall.height) // 10 :].mean())
    assert law.parameters["rest"] == pytest.approx(level, rel=0.02)
    assert fall_prediction_error(law, fall, level) < 0.03


def test_small_swing_and_motion_follow() -> None:
    law = predict(damper())
    assert law.at_rest is not None
    assert 0.055 < law.at_rest.height < 0.063  # simulated: 0.0591 m
    assert law.at_rest.period == pytest.approx(0.288, rel=0.05)  # simulated
    motion = law.simulate(np.linspace(0.0, 30.0, 3001))
    assert motion.height[0] == 0.12
    assert motion.height[-1] == pytest.approx(law.at_rest.height, rel=0.02)


def test_the_law_stands_up_to_the_drag_that_was_tried() -> None:
    """The source's own damper is beyond it."""
    assert predict_bed_parameters(damper(drag=1.0))["weight"] == pytest.approx(16.05, rel=1e-3)
    with pytest.warns(OutsideRangeWarning, match=r"'damper-source' .* 1\.23 times the limit"):
        predict(load_scene("damper-source"))


def followed(law: PredictedLaw) -> np.ndarray:
    """Heights of two seconds from 20 D on."""
    field = compile_rates(law.law.equation, (), "math")
    numbers = [law.parameters[name] for name in law.law.parameters]

    def rates(state: np.ndarray, _: float) -> tuple[float, float, float]:
        z, v, w = map(float, state)
        acceleration, stress = field(z, v, w, *numbers)
        return v, acceleration, stress

    found = odeint(rates, (0.12, 0.0, 0.0), np.linspace(0.0, 2.0, 801), rtol=1e-7, atol=1e-9)
    return np.asarray(found[:, 0])


def test_friction_of_the_piston_is_added_to_the_law() -> None:
    """The piston hardly creeps where the bed's force is within it."""
    plain, rubbing = predict(damper()), predict(damper().replace(**{"piston.friction": 5.0}))
    assert rubbing.at_rest is None
    fraction = rubbing.parameters["friction"] / rubbing.parameters["weight"]
    assert fraction == pytest.approx(5.0 / (WEIGHT * 7.5 * 9.8))
    heights, freely = (followed(law) for law in (rubbing, plain))
    assert np.ptp(heights[600:]) < 0.05 * np.ptp(freely[600:])
    with pytest.raises(InputError, match="friction of the piston"):
        predict_bed_parameters(damper().replace(**{"piston.friction": 5.0}))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {
                "piston.mass": None,
                "output.record": None,
                "protocol": [{"kind": "hold", "name": "a", "duration": 1.0}],
            },
            "nothing falls",
        ),
        ({"effects.gravity": None}, "nothing falls"),
        ({"effects.friction": True}, "has friction"),
        ({"effects.gravity.acceleration": 0.0}, "nothing falls"),
        ({"effects.walls.left": "none"}, r"has effects\.walls\.left = 'none'; .* simulate the scene"),
        ({"effects.walls.bottom": "none"}, r"effects\.walls\.bottom = 'none'"),
        (
            {"effects.walls.bottom": {"law": "slab", "gap_start": 0.1, "gap_end": 0.12}},
            r"bottom\.gap_start = 0\.1 m",
        ),
        (
            {"effects.walls.left": {"energy": "a*(l/w)**3", "a": "1 uJ", "l": "6 mm"}},
            r"walls\.left\.law = 'formula'",
        ),
        ({"pairs": {"method": "cut-off", "cut_off": "2 D"}}, r"pairs\.method = 'cut-off'"),
        ({"pairs": {"method": "verlet-list"}}, r"pairs\.method = 'verlet-list'"),
    ],
)
def test_what_is_not_known_is_refused(changes: dict[str, Any], said: str) -> None:
    scene = damper().replace(**changes)
    for known in (predict, whole_fall, valid_shaking_range):
        with pytest.raises(InputError, match=said):
            known(scene)


@pytest.mark.parametrize("law", ["infinite", {"law": "slab", "length": 1.0}])
def test_other_walls_of_the_package_hold_a_bed(law: Any) -> None:
    plain, other = predict(damper()), predict(damper().replace(**{"effects.walls.left": law}))
    assert other.parameters == plain.parameters


DISCS = {"grains.magnets": "cylinders", "effects.contact": {"modulus": "1 GPa"}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grains.count": 92}, "92 grains"),
        ({"effects.drag.coefficient": 1.2}, "follows its piston too late"),
        ({"effects.drag.coefficient": 50.0}, "follows its piston too late"),
        ({"piston.mass": 0.5}, "more piston.mass"),
        ({"effects.walls.left": {"law": "discs", "pitch": "9 mm"}, **DISCS}, "those that touch"),
        ({"effects.walls.left": {"law": "discs", "pitch": "6 mm"}}, "on all sides of a bed of discs"),
    ],
)
def test_what_was_compared_with_nothing_is_told_with_a_warning(changes: dict[str, Any], said: str) -> None:
    scene = damper().replace(**changes)
    with pytest.raises(InputError, match=said):
        predict_bed_parameters(scene)
    with pytest.warns(OutsideRangeWarning, match=said):
        law = predict(scene)
    height = law.simulate(np.linspace(0.0, 0.5, 51)).height
    assert np.isfinite(height).all()
    assert (height[-1] - height[0]) * (law.parameters["rest"] - height[0]) > 0.0
