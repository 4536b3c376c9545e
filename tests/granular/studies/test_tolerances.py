"""Effect of the tolerances of a damper's parts on equilibrium height, frequency and damping."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene
from granular.__main__ import main
from granular.linear import motion_friction, piston_roots, slopes
from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import Equilibrium, equilibrium_from, relax_until_forces_reduced
from granular.parts.magnets import REFERENCE_TEMPERATURE, REMANENCE_SLOPE
from granular.schema.sections import find_field_value_and_kind
from granular.shared.errors import InputError
from granular.studies import tolerances as module
from granular.studies.tolerances import (
    Part,
    Tolerances,
    read_part_tolerances,
    scene_with_shifted_parts,
    tolerances,
    tolerances_at,
    usual_parts,
)
from tests.granular.linear.small_beds import at_rest, small_damper

TWO = {"grains.remanence": "2.5%", "piston.mass": "0.01 kg"}
SIX = TWO | {
    "cell.width": "0.3 mm",
    "grains.species.0.diameter": "0.05 mm",
    "grains.thickness": "2 %",
    "effects.drag.coefficient": "5 %",
}


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    return at_rest(small_damper())


@pytest.fixture(scope="module")
def oiled() -> Equilibrium:
    """Return the same bed with commercial magnets and oil."""
    return at_rest(
        small_damper(
            **{
                "grains.grade": "N42",
                "grains.coating": "15 um",
                "grains.temperature": 30.0,
                "effects.drag.liquid": "silicone oil 350 cSt",
                "cell.separation": "3.4 mm",
            }
        )
    )


def two_parts(changes: list[list[float]], curvatures: list[list[float]], drawn: int = 0) -> Tolerances:
    parts = (Part("a", 2.0, "m", 0.02, True), Part("b", 0.0, "m", 0.1, False))
    straight, curved = (np.array([values, values]) for values in (changes, curvatures))
    slopes, sides = straight / [[0.01], [0.1]], np.stack([straight + curved, curved - straight], axis=2)
    return Tolerances("toy", parts, np.ones((2, 3)), slopes, sides, np.zeros((drawn, 3)))


def test_contributions_of_tolerances_add_in_quadrature() -> None:
    toy = two_parts([[0.03, 0.0, 0.01], [-0.04, 0.02, 0.0]], [[0.0] * 3] * 2)
    np.testing.assert_allclose(toy.totals, [0.05, 0.02, 0.01], rtol=1e-14)
    np.testing.assert_allclose(toy.slopes[0], [[3.0, 0.0, 1.0], [-0.4, 0.2, 0.0]], rtol=1e-14)
    assert toy.largest(1) == {"rest": ("b",), "f0": ("b",), "zeta": ("a",)}
    assert toy.largest() == {"rest": ("b", "a"), "f0": ("b",), "zeta": ("a",)}
    assert toy.curved == ()


def test_a_nonlinear_effect_of_a_tolerance_is_reported() -> None:
    # sqrt(1 + 2 (c/a)^2) is 1.05 at c/a = 0.2264.
    assert two_parts([[0.1] * 3, [0.0] * 3], [[0.022] * 3, [0.0] * 3]).curved == ()
    toy = two_parts([[0.1] * 3, [0.0] * 3], [[0.0, 0.023, 0.0], [0.0] * 3])
    assert toy.curved == ("a",)
    assert "Slopes alone are not sufficient for a, whose effect is nonlinear: draw dampers" in str(toy)


@pytest.mark.parametrize(
    ("key", "tolerance", "deviation"),
    [
        ("grains.remanence", "2.5%", 0.0325),
        ("cell.width", " 0.2 mm ", 2e-4),
        ("cell.width", "0.1 D", 6e-4),
        ("piston.mass", 0.05, 0.05),
        ("grains.species.grain.diameter", "50 um", 5e-5),
        ("piston.drag", "2 kg/s", 2.0),
    ],
)
def test_tolerances_are_read_in_percent_or_with_units_or_in_si(
    key: str, tolerance: str | float, deviation: float
) -> None:
    (part,) = read_part_tolerances(load_scene("damper"), {key: tolerance})
    assert part.deviation == pytest.approx(deviation, rel=1e-12)
    assert part.one_sided == (key == "piston.drag")


def test_tolerances_of_temperatures_are_in_kelvin() -> None:
    warm = load_scene("damper").replace(**{"grains.temperature": 30.0})
    assert read_part_tolerances(warm, {"grains.temperature": "3 K"})[0].deviation == 3.0
    with pytest.raises(InputError, match="temperature = 30 degC cannot have a relative tolerance, '3 %'"):
        read_part_tolerances(warm, {"grains.temperature": "3 %"})


@pytest.mark.parametrize(
    ("key", "tolerance", "message"),
    [
        (
            "grains.mass",
            "1%",
            r"'grains\.mass' is not a numeric key of a part .*'damper'; choose one of .*piston\.mass",
        ),
        ("grains.count", "1%", "not a numeric key of a part"),
        ("grains.coating", "1 um", "not a numeric key of a part"),
        ("piston.height", "1 mm", "not a numeric key of a part"),
        ("output.frames", "1 ms", "not a numeric key of a part"),
        (
            "cell.width",
            "2 kg",
            r"tolerance of cell\.width: '2 kg' has the unit kg; a quantity in m is wanted",
        ),
        ("cell.width", "__import__('os')", "is not a quantity"),
        ("cell.width", "-1 mm", "must be above 0"),
        ("cell.width", "0%", "must be above 0"),
        ("piston.drag", "5 %", "cannot have a relative tolerance"),
    ],
)
def test_invalid_tolerances_are_refused_in_one_line(key: str, tolerance: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_part_tolerances(load_scene("damper"), {key: tolerance})
    assert "\n" not in str(caught.value)


def test_arguments_without_a_part_or_a_bed_are_refused() -> None:
    with pytest.raises(InputError, match="no part has a tolerance"):
        tolerances(load_scene("damper"), {})
    with pytest.raises(InputError, match="beds = 0, draws = None, seed = 0; beds must be 1"):
        tolerances(load_scene("damper"), TWO, beds=0)
    with pytest.raises(InputError, match=r"seed = -1; .* draws and seed 0 or more"):
        tolerances(load_scene("damper"), TWO, seed=-1)
    with pytest.raises(InputError, match=r"has no friction, which amplitude = 0\.001 m"):
        tolerances(load_scene("damper"), TWO, amplitude=1e-3)


def test_a_tolerance_without_effect_is_not_reported_as_nonlinear(rest: Equilibrium) -> None:
    """Without a given amplitude, friction has no effect.

    Results for more and for less friction then differ only by rounding.
    """
    scene = rest.scene.replace(**{"piston.friction": 0.05})
    found = tolerances_at(
        [dataclasses.replace(rest, scene=scene)], read_part_tolerances(scene, {"piston.friction": "20 %"})
    )
    assert found.curved == ()
    assert len(found.drawn) == 0


def test_sensitivities_to_tolerances_agree_with_small_finite_changes(rest: Equilibrium) -> None:
    keys = tuple(SIX)
    tight = read_part_tolerances(rest.scene, dict.fromkeys(keys, "0.01 %"))
    found = tolerances_at([rest], tight)
    np.testing.assert_allclose(found.slopes[0], slopes(rest, keys).values, rtol=1e-4, atol=2e-5)
    assert np.abs(found.sides.mean(axis=2)).max() < 1e-6


def test_results_for_shifted_parts_agree_with_equilibria_of_changed_scenes(rest: Equilibrium) -> None:
    """A value is changed by 5 % in both directions.

    The results agree with equilibria and eigenvalues of scenes with the changed value.
    """
    (part,) = read_part_tolerances(rest.scene, {"grains.remanence": "5%"})
    found = tolerances_at([rest], [part])
    figures = []
    for factor in (1.05, 0.95):
        scene = rest.scene.replace(**{"grains.remanence": 1.3 * factor})
        changed = equilibrium_from(scene, rest.positions, rest.piston_height)
        root = piston_roots(changed)[0]
        figures.append([changed.piston_height, root.frequency, root.damping_ratio])
    up, down = np.array(figures, dtype=float) / found.figures[0] - 1.0
    np.testing.assert_allclose(found.sides[0, 0], [up, down], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.slopes[0, 0], 0.5 * (up - down) / 0.05, rtol=1e-6, atol=1e-8)


def test_sensitivities_to_tolerances_use_smaller_steps_if_the_bed_rearranges(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sensitivities are computed for the settled packing, contributions of tolerances for the rearranged
    packing.
    """
    parts = read_part_tolerances(rest.scene, TWO)
    wanted = tolerances_at([rest], parts)

    def packs_otherwise(bed: Any, by: np.ndarray) -> tuple[np.ndarray, bool]:
        change, far = changes(bed, by)
        return (change + 0.3, True) if np.abs(by).max() > 0.5 else (change, far)

    changes = module._BedWithShiftedParts.relative_changes_and_rearranged
    monkeypatch.setattr(module._BedWithShiftedParts, "relative_changes_and_rearranged", packs_otherwise)
    found = tolerances_at([rest], parts, draws=3)
    np.testing.assert_allclose(found.slopes, wanted.slopes, rtol=2e-2, atol=1e-9)
    np.testing.assert_allclose(found.sides, wanted.sides + 0.3, rtol=1e-12)
    assert found.curved == tuple(TWO)
    numbers = np.random.default_rng(0).standard_normal((3, 2))
    assert found.rearranged == np.count_nonzero(np.abs(numbers).max(axis=1) > 0.5) == 2
    assert "The packing differs from the settled bed in 2 drawn dampers, which are included." in found.notes


def test_random_dampers_are_drawn_if_the_effect_of_a_tolerance_is_nonlinear(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DRAWS", 5)
    wide = read_part_tolerances(rest.scene, {"grains.remanence": "2 %", "piston.mass": "20 %"})
    bent = tolerances_at([rest], wide)
    assert bent.curved == ("piston.mass",)
    assert len(bent.drawn) == 5
    assert len(tolerances_at([rest], wide[:1]).drawn) == 0
    assert len(tolerances_at([rest], wide, draws=0).drawn) == 0


def test_a_rearranged_bed_is_a_stable_equilibrium(rest: Equilibrium) -> None:
    parts = read_part_tolerances(rest.scene, {"grains.remanence": "40 %"})
    changes, rearranged = module._BedWithShiftedParts(rest, parts, None).relative_changes_and_rearranged(
        np.array([-1.0])
    )
    assert rearranged
    scene = rest.scene.replace(**{"grains.remanence": 0.6 * 1.3})
    bed, stiffness = BedForces(scene), rest.pencil.stiffness.diagonal()
    at = relax_until_forces_reduced(
        bed, bed.coordinates(rest.positions, rest.piston_height), (), stiffness, 1e-9
    )
    changed = equilibrium_from(scene, bed.positions(at), float(at[-1]))
    assert changed.is_stable
    root, before = piston_roots(changed)[0], piston_roots(rest)[0]
    wanted = [changed.piston_height / rest.piston_height, root.frequency / before.frequency]
    np.testing.assert_allclose(changes[:2] + 1.0, wanted, rtol=1e-6)


def test_spread_of_randomly_drawn_dampers_agrees_with_the_linear_estimate(rest: Equilibrium) -> None:
    found = tolerances_at([rest], read_part_tolerances(rest.scene, SIX), draws=50, seed=3)
    assert found.curved == ()
    # The standard deviation of 50 samples has an error of 10 %.
    np.testing.assert_allclose(found.totals, found.sums_of_squares, rtol=0.25)
    assert not np.array_equal(found.totals, found.sums_of_squares)


def test_sensitivities_to_values_of_commercial_parts_follow_their_formulas(oiled: Equilibrium) -> None:
    wanted = {"grains.temperature": "3 K", "grains.coating": "5 um", "effects.drag.viscosity": "5 %"}
    parts = read_part_tolerances(
        oiled.scene, wanted | {"cell.separation": "0.02 mm", "grains.remanence": "0.1 %"}
    )
    found = tolerances_at([oiled], parts, draws=0)
    by_temperature, by_coating, by_viscosity, by_gap, by_remanence = found.slopes[0]
    # The remanence has the factor 1 - 0.0012 (T - 20); viscosity does not affect the equilibrium.
    factor = REMANENCE_SLOPE / (1.0 + REMANENCE_SLOPE * (30.0 - REFERENCE_TEMPERATURE))
    assert by_temperature[0] == pytest.approx(factor * by_remanence[0], rel=1e-3)
    assert by_coating[0] < 0.0
    assert by_viscosity[2] == pytest.approx(1.0, abs=0.01)
    # Films of 0.2 mm on both sides: gamma is proportional to 1/(E - t), with E/(E - t) = 8.5.
    assert by_gap[2] == pytest.approx(-8.5, rel=0.02)


def test_tolerances_of_viscosity_and_temperature_both_contribute(oiled: Equilibrium) -> None:
    """In a scene, a given viscosity would take precedence over the liquid, whose viscosity depends on
    temperature.
    """
    both = {"effects.drag.viscosity": "5 %", "grains.temperature": "3 K"}
    first = tolerances_at([oiled], read_part_tolerances(oiled.scene, both), draws=2)
    parts = read_part_tolerances(oiled.scene, both)
    warmer, both_moved = (
        scene_with_shifted_parts(oiled.scene, parts, np.array(by)).effects.drag
        for by in ([0.0, 1.0], [0.5, 1.0])
    )
    assert warmer is not None
    assert both_moved is not None
    assert warmer.viscosity is not None
    assert both_moved.viscosity == pytest.approx(warmer.viscosity * 1.025)
    assert np.isfinite(first.drawn).all()


@pytest.mark.parametrize("changes", [{}, {"effects.drag.coefficient": 0.2}, {"effects.drag.packing": 0.4}])
def test_a_tolerance_of_one_value_does_not_change_related_values(changes: dict[str, Any]) -> None:
    """Examples are grade and remanence, liquid and drag coefficient, drag and viscosity."""
    scene = load_scene("workshop").replace(**changes)
    blade = "piston.drag" if not changes else "piston.blade.film"
    wide = {blade: "1 %", "effects.drag.coefficient": "1 %", "effects.drag.viscosity": "1 %"}
    parts = read_part_tolerances(scene, wide | {"grains.remanence": "1 %", "grains.coating": "1 um"})
    gentle = scene_with_shifted_parts(scene, parts, np.full(5, 1e-9))
    for key in ("piston.drag", "effects.drag.coefficient", "effects.drag.viscosity", "grains.permeability"):
        (before, _), (after, _) = (
            find_field_value_and_kind(scene, key),
            find_field_value_and_kind(gentle, key),
        )
        assert after == pytest.approx(before, rel=1e-6), key
    moments = [bed.grains.magnets_in_species()[0].moment for bed in (scene, gentle)]
    assert moments[1] == pytest.approx(moments[0], rel=1e-6)
    thicker = scene_with_shifted_parts(scene, parts[2:3], np.ones(1))
    assert thicker.piston.drag == pytest.approx(1.01 * scene.piston.drag)
    measured = "effects.drag.coefficient" in changes
    assert thicker.effects.drag.coefficient == pytest.approx(
        (1.0 if measured else 1.01) * scene.effects.drag.coefficient
    )
    assert ("effects.drag.coefficient" in usual_parts(scene)) == measured


def test_variances_by_tolerances_are_averaged_over_beds() -> None:
    toy = two_parts([[0.0] * 3, [0.0] * 3], [[0.0] * 3] * 2)
    changes = np.array([[[0.03] * 3, [0.0] * 3], [[-0.01] * 3, [0.0] * 3]])
    sides = np.stack([changes, -changes], axis=2)
    toy = dataclasses.replace(toy, slopes=changes / [[0.01], [0.1]], sides=sides)
    np.testing.assert_allclose(toy.totals, (0.5 * (0.03**2 + 0.01**2)) ** 0.5)
    # Variances of 9 and 1: half of sqrt((4^2 + 4^2)/1)/sqrt(2) over 5.
    np.testing.assert_allclose(toy.errors, 0.4)
    assert "The beds differ so much that ± of zeta has a standard error of 40 %" in str(toy.notes)
    assert "+1.0000 ± 2.8284" in str(toy)  # sqrt((2^2 + 2^2)/1)


@pytest.mark.long  # compiles the piston's drag
def test_a_part_value_of_zero_that_cannot_be_negative_is_only_increased_by_its_tolerance(
    rest: Equilibrium,
) -> None:
    found = tolerances_at([rest], read_part_tolerances(rest.scene, {"piston.drag": "0.05 kg/s"}))
    damped = equilibrium_from(rest.scene.replace(**{"piston.drag": 0.05}), rest.positions, rest.piston_height)
    wanted = piston_roots(damped)[0].damping_ratio / found.figures[0, 2] - 1.0
    assert found.contributions[0, 2] == pytest.approx(wanted, rel=1e-6)
    assert found.sides[0, 0, 1, 2] == -found.sides[0, 0, 0, 2]


def test_effect_of_tolerances_on_damping_at_a_given_amplitude_includes_friction(rest: Equilibrium) -> None:
    friction = {"effects.friction": {"static": 0.02, "dynamic": 0.015}}
    scene = rest.scene.replace(**friction)
    rubbing = equilibrium_from(scene, rest.positions, rest.piston_height)
    parts = read_part_tolerances(scene, {"effects.friction.dynamic": "10 %", "cell.separation": "0.01 mm"})
    found = tolerances_at([rubbing], parts, amplitude=2e-3, draws=0)
    root = piston_roots(rest)[0]
    added = motion_friction(rubbing, root=root).equivalent_damping_ratio(2e-3)
    assert found.figures[0, 2] == pytest.approx(root.damping_ratio + added, rel=1e-9)
    # 2 F_c/(pi k a) is proportional to the coefficient.
    assert found.slopes[0, 0, 2] == pytest.approx(added / (root.damping_ratio + added), rel=1e-6)
    # Discs tilt more in a wider gap.
    wide, narrow = (
        motion_friction(
            equilibrium_from(scene.replace(**{"cell.separation": gap}), rest.positions, rest.piston_height),
            root=root,
        ).equivalent_damping_ratio(2e-3)
        for gap in (3.11e-3, 3.09e-3)
    )
    assert wide > narrow
    wanted = 0.5 * (wide - narrow) / found.figures[0, 2]
    assert found.slopes[0, 1, 2] == pytest.approx(wanted * 310.0, rel=1e-6)
    assert found.slopes[0, 1, 0] == 0.0
    assert "includes dry friction, at an amplitude of 2 mm" in str(found)
    with pytest.raises(InputError, match="has no friction"):
        tolerances_at([rest], parts[1:], amplitude=2e-3)


def test_default_tolerances_are_given_only_for_parts_of_the_scene(oiled: Equilibrium) -> None:
    plain, bought = usual_parts(small_damper()), usual_parts(oiled.scene)
    assert "effects.drag.coefficient" in plain
    assert not {"cell.separation", "grains.coating", "grains.temperature"} & plain.keys()
    assert {
        "cell.separation",
        "grains.coating",
        "grains.temperature",
        "effects.drag.viscosity",
    } <= bought.keys()
    assert "effects.drag.coefficient" not in bought
    # Limits of 2.5 % are a standard deviation of 2.5/sqrt(3) %.
    (part,) = read_part_tolerances(oiled.scene, {"grains.remanence": bought["grains.remanence"]})
    assert part.deviation / part.value == pytest.approx(0.025 / 3.0**0.5, rel=1e-3)
    assert read_part_tolerances(oiled.scene, bought)


def test_command_tolerances_prints_a_table_and_writes_a_page(
    rest: Equilibrium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def beds(scene: Scene, count: int, **_: object) -> list[object]:
        return [(scene, rest.positions, rest.piston_height)] * count

    monkeypatch.setattr(module, "settled_beds", beds)
    path, out = tmp_path / "scene.toml", tmp_path / "out"
    path.write_text(rest.scene.to_toml(), encoding="utf-8")
    words = ["tolerances", str(path), "--usual", "--part=piston.mass=1%", "--beds=2", "--draws=0", "--quiet"]
    main([*words, "-o", str(out)])
    shown = capsys.readouterr().out
    assert "0.3 kg ± 1 %" in shown
    assert "of the parts: rest ±" in shown
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Largest causes" in page
    assert "<svg" in page
    main([*words, "--json"])
    plain = json.loads(capsys.readouterr().out)
    squares = sum(part["contributions"][0] ** 2 for part in plain["parts"].values())
    assert plain["totals"]["rest"] == pytest.approx(squares**0.5)
    assert plain["parts"]["piston.mass"]["deviation"] == pytest.approx(0.003)
