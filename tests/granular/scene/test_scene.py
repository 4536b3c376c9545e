"""Scenes: saving and reading, changes, clear errors, and the initial state of a run."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import Scene, load_scene, scene_names
from granular.scene.arrangement import (
    Arrangement,
    check_positions_free_of_overlap,
    initial_positions_and_velocities,
)
from granular.schema.apparatus import Grains, Piston, Species
from granular.schema.cell import Cell
from granular.schema.units import si_value
from granular.shared.errors import SceneError

POSITIVE = st.floats(1e-3, 1e3)


@pytest.mark.parametrize("name", scene_names())
def test_packaged_scenes_are_restored_exactly_from_their_toml_text(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert Scene.from_plain(tomllib.loads(scene.to_toml())) == scene
    scene.save(tmp_path / "copy.toml")
    assert load_scene(tmp_path / "copy.toml") == scene
    assert load_scene(str(tmp_path / "copy.toml")).digest() == scene.digest()


@settings(max_examples=60, deadline=None)
@given(
    mass=POSITIVE,
    drag=st.floats(0.0, 1e3),
    gravity=st.floats(0.0, 30.0),
    width=st.floats(0.36, 10.0),
    seed=st.integers(0, 2**31),
    jitter=st.floats(0.0, 0.1),
    until=st.sampled_from([None, "rest"]),
    duration=st.floats(1.5, 100.0),
    left=st.sampled_from([None, {"law": "experimental"}]),
)
def test_random_scenes_are_restored_exactly_from_their_toml_text(
    mass: float,
    drag: float,
    gravity: float,
    width: float,
    seed: int,
    jitter: float,
    until: str | None,
    duration: float,
    left: dict | None,
) -> None:
    scene = load_scene("damper").replace(
        **{
            "piston.mass": mass,
            "effects.drag.coefficient": drag,
            "cell.width": width,
            "effects.gravity.acceleration": gravity,
            "arrangement.seed": seed,
            "arrangement.jitter": jitter,
            "protocol.drop.until": until,
            "protocol.drop.duration": duration,
            "effects.walls.left": left,
        }
    )
    assert Scene.from_plain(tomllib.loads(scene.to_toml())) == scene


@settings(max_examples=200, deadline=None)
@given(value=st.floats(-1e6, 1e6, allow_nan=False), unit=st.sampled_from(["m", "mm", "cm", "um", "km", "nm"]))
def test_lengths_with_units_are_converted(value: float, unit: str) -> None:
    size = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "km": 1e3, "nm": 1e-9}[unit]
    assert si_value(f"{value!r} {unit}", "m") == pytest.approx(value * size, rel=1e-15, abs=1e-300)


def test_quantities_with_units_are_converted() -> None:
    assert si_value("5 mm", "m") == 0.005
    assert si_value("8.33 mm/s", "m/s") == 0.00833
    assert si_value("20 D", "m", 0.006) == 0.12
    assert si_value("0.2 D", "m", 0.006) == 0.0012
    assert si_value("1e-2 D/s", "m/s", 0.006) == pytest.approx(6e-5)
    assert si_value("9.8 N/kg", "m/s^2") == 9.8
    assert si_value("2", "kg") == 2.0
    assert si_value("90 deg", "1") == pytest.approx(np.pi / 2)


def test_replace_returns_a_new_scene_and_keeps_the_old_one(damper: Scene) -> None:
    other = damper.replace(**{"grains.count": 92, "piston.mass": "8 kg", "piston.height": "21 D"})
    assert (damper.grains.count, damper.piston.mass) == (368, 7.5)
    assert (other.grains.count, other.piston.mass) == (92, 8.0)
    assert other.piston.height == pytest.approx(21 * 0.006)
    assert damper.replace() == damper
    with pytest.raises(dataclasses.FrozenInstanceError):
        damper.piston.mass = 3.0


def test_replace_adds_and_removes_parts_of_a_scene(damper: Scene) -> None:
    bare = damper.replace(**{"effects.drag": None, "effects.gravity": "none"})
    assert bare.effects.drag is None
    assert bare.effects.gravity is None
    back = bare.replace(**{"effects.drag.coefficient": 0.1, "effects.gravity": True})
    assert back == damper


def test_items_of_a_list_in_a_scene_are_selected_by_name_or_index(damper: Scene) -> None:
    by_name = damper.replace(**{"protocol.release.duration": 3})
    assert by_name == damper.replace(**{"protocol.2.duration": "3 s"})
    assert by_name.protocol[2].duration == 3.0


def test_species_are_distributed_evenly_over_the_grains() -> None:
    species = [
        {"name": "big", "diameter": 0.005, "share": 0.7},
        {"name": "small", "diameter": 0.003, "share": 0.3},
    ]
    scene = load_scene("bed").replace(**{"grains.species": species, "grains.count": 100})
    assert scene.grains.species_counts() == (70, 30)
    assignment = scene.grains.species_indices()
    assert np.bincount(assignment).tolist() == [70, 30]
    runs = np.bincount(np.add.reduceat(assignment, np.arange(0, 100, 10)))
    assert runs.argmax() == 3
    assert len(np.flatnonzero(runs)) <= 2


BAD = [
    ({"grains.cuont": 3}, "grains: unknown key 'cuont'; did you mean 'count'?"),
    ({"grians.count": 3}, "unknown key 'grians'; did you mean 'grains'?"),
    ({"effects.drga.coefficient": 1}, "did you mean 'drag'?"),
    ({"effects.superconductivity": {}}, "contact, dipole, drag"),
    ({"protocol.dorp.duration": 3}, "unknown item 'dorp'; did you mean 'drop'?"),
    ({"protocol.0.kind": "fre"}, "unknown kind 'fre'; did you mean 'free'?"),
    ({"output.record": "relaese"}, "unknown stage 'relaese'; did you mean 'release'?"),
    ({"effects.walls.left": "infinte"}, "unknown law of a wall 'infinte'"),
    ({"grains.count": -1}, "grains.count: -1 must be at least 0"),
    ({"grains.count": 2.5}, "2.5 must be an integer"),
    ({"grains.count": True}, "must be an integer"),
    ({"grains.count": "many"}, "'many' is not a number"),
    ({"grains.count": None}, "grains.count: must be given"),
    ({"grains.count.parts": 1}, "grains.count: has no parts"),
    ({"cell.width": "3 kg"}, "cell.width: '3 kg' has the unit kg; a quantity in m is wanted"),
    ({"cell.width": "3 parsec"}, "unknown unit 'parsec'"),
    ({"cell.width": "wide"}, "'wide' is not a quantity"),
    ({"cell.width": -1}, "cell.width: -1 m must be above 0 m"),
    ({"cell.width": 0}, "0 m must be above 0 m"),
    ({"cell.width": float("nan")}, "nan must be finite"),
    ({"cell.width": float("inf")}, "inf must be finite"),
    ({"cell": 3}, "3 is not a table; give a table with the keys width, separation"),
    ({"piston.mass": -7.5}, "piston.mass: -7.5 kg must be above 0 kg"),
    ({"piston.mass": None}, "piston.mass: is missing, but the piston moves freely in stage 'drop'"),
    ({"piston": None}, "the scene has no piston"),
    ({"piston.height": "5 D"}, "into the piston"),
    ({"effects.drag.coefficient": -0.1}, "-0.1 kg/s must be at least 0 kg/s"),
    ({"arrangement.jitter": 0.6}, "0.6 must be below 0.5"),
    ({"grains.count": 4000}, "could overlap"),
    ({"grains.species.grain.diameter": "2 cm"}, "could overlap"),
    ({"grains.species.grain.share": 0.9}, "the shares add up to 0.9"),
    ({"grains.species": []}, "must hold at least 1 table"),
    ({"arrangement.positions": [[0.1, 0.1]]}, "holds 1 pairs for grains.count = 368"),
    ({"arrangement.positions": "everywhere"}, "must be a pair"),
    ({"arrangement.velocities": [[0.1, 0.1]]}, "are given without positions"),
    ({"protocol.release.until": "tomorrow"}, "unknown choice 'tomorrow'"),
    ({"protocol.release.tolerance": 0.1}, "has an effect only with until"),
    ({"protocol.drop.duration": 0.5}, "does not exceed window = "),
    ({"protocol.lift.name": "drop"}, "the name 'drop' is given twice"),
    ({"protocol": [{"name": "nothing"}]}, "must be given; use one of hold, move, descend"),
    ({"protocol": [{"kind": "move", "name": "m", "to": 0.1}]}, "speed or duration is needed"),
    ({"name": ""}, "must be a non-empty string"),
    ({"name": "d\udce4mper"}, "must be one line of at most 200 printable characters"),
    ({"protocol.lift": None, "protocol.release": None}, "protocol.1: None must be a table"),
    (
        {"grains.species": [5], "grains.species.0.diameter": 1},
        "grains.species.0: has no parts; remove '.diameter'",
    ),
]


@pytest.mark.parametrize(("changes", "words"), BAD, ids=[next(iter(one[0])) for one in BAD])
def test_invalid_scenes_are_refused(damper: Scene, changes: dict, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        damper.replace(**changes)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


PLACES = {"grains.count": 2, "arrangement.positions": [[0.1, 0.05], [0.2, 0.05]]}


@pytest.mark.parametrize(
    ("name", "value", "remedy"),
    [
        ("speed", 0.1, "give velocities"),
        ("jitter", 0.15, "remove it"),
        ("height", 0.1, "remove it"),
        ("seed", 2, "remove it"),
    ],
)
def test_keys_of_the_initial_grid_are_refused_if_positions_are_given(
    damper: Scene, name: str, value: float, remedy: str
) -> None:
    with pytest.raises(SceneError, match=f"arrangement.{name}: applies only to the grid.*{remedy}"):
        damper.replace(**PLACES, **{f"arrangement.{name}": value})
    assert damper.replace(**{f"arrangement.{name}": value}).replace(**PLACES) == damper.replace(**PLACES)


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        ([[0.1, 0.05], [0.104, 0.05]], "grains 0 and 1 overlap"),
        ([[0.1, 0.05], [0.1, 0.05]], "grains 0 and 1 overlap"),
        ([[0.001, 0.05], [0.1, 0.05]], "grain 0 extends 0.002 m into the left wall"),
        ([[0.1, 0.05], [0.5, 0.05]], "grain 1 extends"),
        ([[0.1, 0.05], [0.2, -0.01]], "into the bottom"),
        ([[0.1, 0.05], [0.2, 0.3]], "into the piston"),
    ],
)
def test_invalid_initial_positions_are_refused(damper: Scene, positions: list, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        damper.replace(**{"grains.count": 2, "arrangement.positions": positions})


def test_invalid_scene_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="did you mean 'damper'"):
        load_scene("dampr")
    with pytest.raises(SceneError, match=r"the scene file .* does not exist"):
        load_scene(tmp_path / "nothing.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(SceneError, match=r"broken\.toml: not a TOML file"):
        load_scene(broken)
    broken.write_text("[grains]\ncount = 3\n")
    with pytest.raises(SceneError, match=r"broken\.toml: grains\.species: must be given"):
        load_scene(broken)


def test_printed_representation_of_a_scene_has_only_a_few_lines() -> None:
    scene = load_scene("damper")
    assert repr(scene).splitlines() == [
        "Scene 'damper': 368 of 6 mm, cell 360 mm wide, piston at 120 mm, 7.5 kg",
        "  effects: dipole, drag, gravity, walls",
        "  stages: drop, lift, release",
    ]
    assert "368 of 6 mm" in scene._repr_latex_()
    assert "by = 0.0012 }" in scene.to_toml()


GRAINS = Grains(count=23, species=(Species(diameter=0.006),))
CELL = Cell(width=0.09)
PISTON = Piston(height=0.036)


def test_grains_start_in_the_cell_with_the_given_speed() -> None:
    plan = Arrangement(seed=3, speed=0.2)
    places, velocities = initial_positions_and_velocities(plan, GRAINS, CELL, PISTON, overlapping=False)
    assert places.shape == velocities.shape == (23, 2)
    assert (places > 0.003).all()
    assert (places < [CELL.width - 0.003, PISTON.height - 0.003]).all()
    assert np.linalg.norm(velocities, axis=1) == pytest.approx(0.2, rel=1e-12)
    other = initial_positions_and_velocities(
        dataclasses.replace(plan, seed=4), GRAINS, CELL, PISTON, overlapping=False
    )
    assert not np.isclose(places, other[0]).any(axis=1).all()


def test_grains_may_overlap_initially_only_in_scenes_with_contact_forces() -> None:
    two = dataclasses.replace(GRAINS, count=2)
    near = Arrangement(positions=((0.02, 0.02), (0.025, 0.02)))
    places, _ = initial_positions_and_velocities(near, two, CELL, PISTON, overlapping=True)
    assert places.tolist() == [[0.02, 0.02], [0.025, 0.02]]
    with pytest.raises(SceneError, match="grains 0 and 1 overlap"):
        initial_positions_and_velocities(near, two, CELL, PISTON, overlapping=False)


def test_an_initial_grid_without_height_requires_a_piston() -> None:
    with pytest.raises(SceneError, match="height: is missing, and there is no piston"):
        initial_positions_and_velocities(Arrangement(), GRAINS, CELL, None, overlapping=False)
    plan = Arrangement(height=0.03)
    assert len(initial_positions_and_velocities(plan, GRAINS, CELL, None, overlapping=False)[0]) == 23


@pytest.mark.parametrize("few", [0, 1000])
@pytest.mark.parametrize("height", [None, 0.03])
def test_check_of_initial_overlaps_finds_every_overlapping_pair(
    height: float | None, few: int, random: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("granular.scene.arrangement.MAX_GRAINS_WITHOUT_TREE", few)
    cell = Cell(width=0.03) if height is None else Cell(width=0.03, sides="periodic", height=height)
    five, overlapping = dataclasses.replace(GRAINS, count=5), 0
    for _ in range(300):
        positions = 0.003 + 0.024 * random.random((5, 2))
        if height is not None:
            positions = 0.03 * random.random((5, 2))
        gaps = np.linalg.norm(
            cell.nearest_image_displacements(positions[:, None] - positions), axis=2
        ) + np.eye(5)
        if gaps.min() < 0.006:
            overlapping += 1
            with pytest.raises(SceneError, match="overlap"):
                check_positions_free_of_overlap(positions, five, cell, None, overlapping=False)
        else:
            check_positions_free_of_overlap(positions, five, cell, None, overlapping=False)
    assert 30 < overlapping < 290
