"""Cell sides of any inclination: forces, motion, friction and outflow compared with exact results."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate
from granular.linear.equilibrium import equilibrium_from
from granular.linear.small_motions import keys_of_nonzero_numbers
from granular.observables.forces import wall_branches_and_forces
from granular.schema.natural_units import Scales
from granular.shared.errors import SceneError
from tests.modes import quick_in_plain_python

D = 6e-3
HOLD = [{"kind": "hold", "name": "hold", "duration": 0.4}]
LAWS: dict[str, Any] = {
    "a": "experimental",
    "b": "infinite",
    "c": "slab",
    "d": {"law": "discs", "pitch": "1.3 D"},
    "e": "slab",
    "f": {"energy": "u*exp(-w/l)", "u": "1 mJ", "l": "9 mm"},
}
"""Wall law of each side of a hexagon."""
GAP = dict.fromkeys("abcdf", "slab") | {"e": {"law": "slab", "gap_start": "2 D", "gap_end": "4 D"}}
ROW = ("experimental", "infinite", "slab", {"law": "discs", "pitch": "1.3 D"})


def polygon(corners: np.ndarray, names: Sequence[str] = "abcdefgh") -> list[dict[str, Any]]:
    """Return the sides of a closed polygon with corners [m] in counter-clockwise order."""
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return [{"name": name, "ends": pair} for name, pair in zip(names, ends.tolist(), strict=False)]


def hexagon_corners() -> np.ndarray:
    """Return the corners [m] of a hexagon with sides of 12 D, rotated by 11 degrees, in the first
    quadrant.
    """
    angle = np.radians(60.0 * np.arange(6) + 11.0)
    corners = 12.0 * D * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(corners - corners.min(axis=0))


def hexagon() -> list[dict[str, Any]]:
    """Return the sides of the hexagon."""
    return polygon(hexagon_corners())


def held_in(sides: list[dict[str, Any]], walls: dict[str, Any], places: Any, **changes: Any) -> Scene:
    """Return a scene of dipoles at positions [m] in a cell without piston, drag and weight."""
    return load_scene("bed").replace(
        **{
            "cell": {"sides": sides},
            "effects": {"dipole": True, "walls": walls},
            "piston": None,
            "protocol": HOLD,
            "grains.count": len(places),
            "arrangement": {"positions": np.asarray(places).tolist()},
            **changes,
        }
    )


def scattered(sides: list[dict[str, Any]], count: int, seed: int = 1) -> np.ndarray:
    """Return random positions [m] in a polygon, at least 1 D from its sides and 1.1 D from each other."""
    ends = np.array([side["ends"] for side in sides])
    along = np.diff(ends, axis=1)[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    random, places = np.random.default_rng(seed), np.empty((0, 2))
    while len(places) < count:
        new = random.uniform(ends.min(axis=(0, 1)), ends.max(axis=(0, 1)))
        inside = (((new - ends[:, 0]) * normal).sum(axis=1) > D).all()
        if inside and (np.linalg.norm(places - new, axis=1) > 1.1 * D).all():
            places = np.concatenate([places, [new]])
    return places


@quick_in_plain_python
def test_equilibrium_and_frequency_of_a_grain_in_a_wedge_agree_with_the_closed_form() -> None:
    """The distance w [D] from two infinite walls of inclination b satisfies w^3 = 2 cos(b) F*/(m g).

    Each wall has the stiffness 3 F*/(D w^4) along its normal.
    """
    incline, tall = math.radians(35.0), 40.0 * D
    half = tall / math.tan(incline)
    sides = [
        {"name": "left", "ends": [[0.0, tall], [half, 0.0]]},
        {"name": "right", "ends": [[half, 0.0], [2.0 * half, tall]]},
    ]
    wedge = {"left": "infinite", "right": "infinite"}
    scene = held_in(sides, wedge, [[half + 0.2 * D, 12.0 * D]], **{"effects.gravity.acceleration": 9.8})
    scales, mass = Scales.from_grains(scene.grains), float(scene.grains.masses()[0])
    w = (2.0 * math.cos(incline) * scales.force * scales.length**3 / (mass * 9.8)) ** (1.0 / 3.0)
    stiffness = 3.0 * scales.force * scales.length**3 / w**4
    rest = equilibrium_from(scene, np.array([[half + 0.1 * D, w / math.cos(incline) + 0.2 * D]]), None)
    np.testing.assert_allclose(rest.positions[0], [half, w / math.cos(incline)], rtol=1e-6)
    squares = np.diag(rest.pencil.full_stiffness) / mass
    known = 2.0 * stiffness / mass * np.array([math.sin(incline), math.cos(incline)]) ** 2
    np.testing.assert_allclose(np.sqrt(squares), np.sqrt(known), rtol=1e-6)
    assert abs(rest.pencil.full_stiffness[0, 1]) < 1e-6 * stiffness


@quick_in_plain_python
def test_forces_on_the_six_sides_of_a_hexagon_and_on_its_grains_cancel() -> None:
    """The force of each wall acts along its normal.

    Rows of magnets and slabs also have a tangential force.
    """
    sides = hexagon()
    places = scattered(sides, 25)
    scene = held_in(sides, LAWS, places)
    found, parts = evaluate(scene, places), wall_branches_and_forces(scene, places)
    on_walls = -parts.forces.sum(axis=0)
    size = np.linalg.norm(on_walls, axis=1).max()
    np.testing.assert_allclose(found.force.sum(axis=0), -on_walls.sum(axis=0), atol=1e-12 * size)
    normals = np.array([line.normal for line in scene.cell.lines])
    outwards = -(on_walls * normals).sum(axis=1)
    np.testing.assert_allclose(list(found.wall_forces.values()), outwards, rtol=1e-12)
    along = np.abs(on_walls[:, 0] * normals[:, 1] - on_walls[:, 1] * normals[:, 0])
    for side, sideways in zip("abcdef", along, strict=True):
        assert (sideways < 1e-12 * size) == (side in "abf"), side  # rows and slabs push along themselves


@pytest.mark.parametrize("walls", [LAWS, GAP], ids=["each another", "slabs with a gap"])
@quick_in_plain_python
def test_force_of_every_wall_law_on_an_inclined_side_is_the_negative_energy_gradient(
    walls: dict[str, Any],
) -> None:
    sides = hexagon()
    places = scattered(sides, 25)
    scene = held_in(sides, walls, places)
    force, step = evaluate(scene, places).force, 2e-4 * D
    for grain in range(0, 25, 3):
        for axis in (0, 1):
            energies = []
            for shift in (-2, -1, 1, 2):
                moved = places.copy()
                moved[grain, axis] += shift * step
                energies.append(evaluate(scene, moved).potential_energy)
            slope = (energies[0] - 8.0 * energies[1] + 8.0 * energies[2] - energies[3]) / (12.0 * step)
            assert -slope == pytest.approx(force[grain, axis], rel=1e-7, abs=1e-7 * np.abs(force).max())


@pytest.mark.parametrize(
    ("walls", "count", "settings", "error"),
    [
        (ROW, 16, {"dt": 2e-5, "t_end": 0.01}, 1e-8),
        # Steps depend on distances alone, so that a turned cell is passed in the same ones.
        (("infinite",) * 4, 6, {"t_end": 0.02, "method": "adaptive-verlet"}, 1e-7),
    ],
    ids=["equal steps", "variable steps"],
)
@quick_in_plain_python
def test_a_rotated_rectangle_gives_rotated_forces_and_motions(
    walls: tuple[Any, ...], count: int, settings: dict[str, Any], error: float
) -> None:
    corners = D * np.array([[0.0, 0.0], [14.0, 0.0], [14.0, 9.0], [0.0, 9.0]])
    laws, places = dict(zip("abcd", walls, strict=True)), scattered(polygon(corners), count)
    turn = np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]])
    shift = -(corners @ turn.T).min(axis=0)
    there = places @ turn.T + shift
    level = held_in(polygon(corners), laws, places)
    inclined = held_in(polygon(corners @ turn.T + shift), laws, there)
    force = evaluate(level, places).force
    turned = evaluate(inclined, there).force
    np.testing.assert_allclose(turned, force @ turn.T, atol=1e-11 * np.abs(force).max())
    runs = [simulate(scene, progress=False, **settings) for scene in (level, inclined)]
    assert len({run.settings()["steps"] for run in runs}) == 1
    paths = [run.dataset["position"].values[-1] for run in runs]
    np.testing.assert_allclose(paths[1], paths[0] @ turn.T + shift, atol=error * D)


def small_bed(count: int) -> Scene:
    """Return the packaged bed in a cell 20 D wide, under a piston at 14 D."""
    size = {"cell.width": "20 D", "piston.height": "14 D", "arrangement.height": "13 D"}
    return load_scene("bed").replace(**{"grains.count": count, **size})


@quick_in_plain_python
def test_rectangular_cell_and_the_same_cell_given_as_a_polygon_have_equal_forces() -> None:
    """The top side of the polygon belongs to the piston; its heights are relative to the piston."""
    bed = small_bed(40)
    places = bed.initial_positions_and_velocities()[0]
    wide, tall = 20.0 * D, 30.0 * D
    sides: list[dict[str, Any]] = [
        {"name": "left", "ends": [[0.0, tall], [0.0, 0.0]]},
        {"name": "right", "ends": [[wide, 0.0], [wide, tall]]},
        {"name": "bottom", "ends": [[0.0, 0.0], [wide, 0.0]]},
        {"name": "top", "ends": [[wide, 0.0], [0.0, 0.0]], "body": "piston"},
    ]
    same = bed.replace(**{"cell": {"sides": sides}, "arrangement": {"positions": places.tolist()}})
    one, other = evaluate(bed, places), evaluate(same, places)
    np.testing.assert_array_equal(one.force, other.force)
    assert one.wall_forces == other.wall_forces
    assert one.piston_force == other.piston_force


@quick_in_plain_python
def test_force_on_a_wedge_shaped_piston_is_the_negative_derivative_of_the_energy() -> None:
    bed = small_bed(30)
    wide, tall = 20.0 * D, 30.0 * D
    sides: list[dict[str, Any]] = [
        {"name": "left", "ends": [[0.0, tall], [0.0, 0.0]]},
        {"name": "bottom", "ends": [[0.0, 0.0], [wide, 0.0]]},
        {"name": "right", "ends": [[wide, 0.0], [wide, tall]]},
        {"name": "up", "ends": [[wide, 0.0], [0.5 * wide, 4.0 * D]], "body": "piston"},
        {"name": "down", "ends": [[0.5 * wide, 4.0 * D], [0.0, 0.0]], "body": "piston"},
    ]
    scene = bed.replace(**{"cell": {"sides": sides}})
    places, step = scene.initial_positions_and_velocities()[0], 1e-3 * D
    energies = [
        evaluate(scene, places, piston_height=14.0 * D + k * step).potential_energy for k in (-2, -1, 1, 2)
    ]
    slope = (energies[0] - 8.0 * energies[1] + 8.0 * energies[2] - energies[3]) / (12.0 * step)
    assert evaluate(scene, places).piston_force == pytest.approx(-slope, rel=1e-8)
    keys = keys_of_nonzero_numbers(scene)  # of slopes: no corner alone
    assert "cell.separation" in keys
    assert not any(key.startswith("cell.sides") for key in keys)


def funnel(opening: float, count: int, law: Any = "slab", **changes: Any) -> Scene:
    """Return two sides inclined by 45 degrees above an opening [D], with grains at rest between them."""
    tall = 14.0 * D
    sides = [
        {"name": "left", "ends": [[0.0, tall], [tall, 0.0]]},
        {"name": "right", "ends": [[tall + opening * D, 0.0], [2.0 * tall + opening * D, tall]]},
    ]
    return load_scene("bed").replace(
        **{
            "cell": {"sides": sides},
            "effects": {"dipole": True, "walls": {"left": law, "right": law}, "gravity": True},
            "piston": None,
            "protocol": HOLD,
            "grains.count": count,
            "arrangement": {"height": "13 D"},
            "output": {"scalars": 1e-3, "frames": 0.01},
            **changes,
        }
    )


def test_error_of_the_energy_balance_in_a_funnel_is_of_second_order_in_the_step() -> None:
    scene = funnel(3.0, 12, **{"effects.drag.coefficient": 0.02})
    residuals = []
    for dt in (8e-5, 4e-5, 2e-5):
        data = simulate(scene, dt=dt, t_end=0.03, progress=False).dataset
        names = ("kinetic_energy", "pair_energy", "wall_energy", "weight_energy", "drag_loss")
        total = sum(data[name].values for name in names)
        residuals.append(float((total - total[0])[-1]))
    orders = np.log2(np.divide(residuals[:-1], residuals[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_outflow_from_a_funnel_is_recorded_and_continues_exactly_in_a_resumed_run(tmp_path: Path) -> None:
    scene = funnel(8.0, 20, **{"effects.drag.coefficient": 0.02})
    flow = simulate(scene, dt=5e-5, progress=False)
    data = flow.dataset
    left = data["departure_grain"].values
    assert 3 < len(left) == 20 - data["grain_count"].values[-1]
    assert sorted(left) == np.flatnonzero(np.isnan(data["position"].values[-1, :, 0])).tolist()
    times, places = data["departure_time"].values, data["departure_position"].values
    assert (np.diff(times) >= 0.0).all()
    counted = 20 - np.searchsorted(times, data["time"].values, side="right")
    assert np.abs(counted - data["grain_count"].values).max() <= 1  # one may leave at a record's time
    assert (places[:, 1] < -5.0 * D).all()
    assert (places[:, 1] > -6.0 * D).all()
    for stop in (0.13, 0.2571, 0.4):
        again = simulate(scene, dt=5e-5, t_end=stop, out=tmp_path / "run", resume=True, progress=False)
    for name in data:
        assert np.array_equal(data[name].values, again.dataset[name].values, equal_nan=True), name


def test_grain_below_an_opening_is_removed_at_the_time_of_free_fall() -> None:
    """It falls far from the walls, and is 5 D below the opening after sqrt(2 (h + 5 D)/g)."""
    changes = {"effects.drag.coefficient": 0.0}  # of no size: as other funnels, which are compiled
    scene = funnel(200.0, 1, **{"arrangement": {"positions": [["114 D", "8 D"]]}, **changes})
    data = simulate(scene, progress=False).dataset
    late = math.sqrt(2.0 * 13.0 * D / 9.8)
    assert late < float(data["departure_time"][0]) < late + 2e-3
    assert float(data["departure_position"][0, 0]) == pytest.approx(114.0 * D, rel=1e-9)


@pytest.mark.parametrize("coefficient", [0.3, 0.6])
@quick_in_plain_python
def test_grain_on_an_incline_slides_or_stays_exactly_at_rest(coefficient: float) -> None:
    """The wall carries m g cos(b). A grain that slides has the acceleration g (sin(b) - mu cos(b))."""
    incline, g = math.radians(30.0), 9.8
    up = np.array([math.cos(incline), math.sin(incline)])
    sides = [{"name": "slope", "ends": [[0.0, 0.0], (400.0 * D * up).tolist()]}]
    scene = held_in(sides, {"slope": "infinite"}, [[60.0 * D, 60.0 * D]])
    scales, mass = Scales.from_grains(scene.grains), float(scene.grains.masses()[0])
    w = (scales.force * scales.length**3 / (mass * g * math.cos(incline))) ** (1.0 / 3.0)
    place = 200.0 * D * up + w * np.array([-up[1], up[0]])
    scene = scene.replace(
        **{
            "arrangement": {"positions": [place.tolist()]},
            "effects.gravity.acceleration": g,
            "effects.wall_friction.coefficient": coefficient,
        }
    )
    data = simulate(scene, dt=1e-4, t_end=0.2, progress=False).dataset
    path = (data["position"].values[:, 0] - place) @ up
    if coefficient > math.tan(incline):
        assert np.abs(path).max() < 1e-14
    else:
        pull = g * (math.sin(incline) - coefficient * math.cos(incline))
        np.testing.assert_allclose(-path, 0.5 * pull * data["frame_time"].values ** 2, rtol=1e-9, atol=1e-12)


SQUARE = D * np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])


def with_hole(lid: str) -> list[dict[str, Any]]:
    """Return the sides of a square of 9 D whose floor has a hole of 3 D.

    The square's lid belongs to the cell or to the piston.
    """
    sides = polygon(SQUARE, "aecd")
    sides[0]["ends"][1][0] = 3.0 * D
    sides.insert(1, {"name": "b", "ends": [[6.0 * D, 0.0], [9.0 * D, 0.0]]})
    if lid == "piston":
        sides[3] |= {"ends": [[9.0 * D, 0.0], [0.0, 0.0]], "body": "piston"}
    return sides


@pytest.mark.parametrize("lid", ["cell", "piston"])
def test_a_hole_in_the_floor_is_recognised_as_an_opening(lid: str) -> None:
    walls = {"a": "slab", "b": "slab", "e": "infinite", "c": "infinite", "d": "infinite"}
    more = {"piston": {"height": "9 D"}} if lid == "piston" else {}
    scene = held_in(with_hole(lid), walls, [[4.5 * D, 4.5 * D]], **more)
    walls_there = scene.effects.walls
    assert walls_there is not None
    assert walls_there.has_gap
    assert not scene.has_closed_walls
    with pytest.raises(SceneError, match=r"walls\.a\.law: 'infinite' is infinitely long and would block"):
        scene.replace(**{"effects.walls.a": "infinite"})


def test_an_open_top_or_a_piston_as_floor_does_not_count_as_an_opening() -> None:
    box = polygon(SQUARE)
    floor = [{**box[0], "body": "piston", "ends": [[0.0, -D], [9.0 * D, -D]]}, *box[1:]]
    for sides, changes in ((box, {"effects.walls.c": "none"}), (floor, {"piston": {"height": D}})):
        scene = held_in(sides, dict.fromkeys("abcd", "infinite"), [[4.5 * D, 4.5 * D]], **changes)
        assert scene.effects.walls is not None
        assert not scene.effects.walls.has_gap


def test_walls_above_and_below_an_opening_in_a_vertical_side_must_be_of_finite_length() -> None:
    sides = polygon(SQUARE, "abcd")
    sides[1]["ends"][1][1] = 4.0 * D
    sides.insert(2, {"name": "e", "ends": [[9.0 * D, 6.0 * D], [9.0 * D, 9.0 * D]]})
    walls = {"a": "slab", "b": "slab", "e": "slab", "c": "infinite", "d": "infinite"}
    scene = held_in(sides, walls, [[4.5 * D, 4.5 * D]])
    with pytest.raises(SceneError, match=r"walls\.e\.law: 'infinite' is infinitely long"):
        scene.replace(**{"effects.walls.e": "infinite"})


def test_names_of_sides_may_equal_attribute_names_of_the_code() -> None:
    names = ("key", "rank", "walls", "has_gap", "to_plain")
    sides = polygon(hexagon_corners()[:5])
    for side, name in zip(sides, names, strict=True):
        side["name"] = name
    scene = held_in(sides, dict.fromkeys(names, "infinite"), [hexagon_corners()[:5].mean(axis=0)])
    again = Scene.from_plain(scene.to_plain())
    assert again == scene
    assert all(wall.law == "infinite" for _, wall in again.effects.walls.sides_with_walls)  # type: ignore[union-attr]
    assert scene.replace(**{"effects.walls.key": "none"}).effects.walls.wall_of("key") is None  # type: ignore[union-attr]


def test_error_for_a_missing_wall_at_the_piston_names_its_key() -> None:
    box = polygon(SQUARE, ["a", "b", "press", "d"])
    box[2] |= {"ends": [[9.0 * D, 0.0], [0.0, 0.0]], "body": "piston"}
    free = [{"kind": "free", "name": "fall", "duration": 0.1}]
    changes = {"piston": {"height": "9 D", "mass": 1.0}, "protocol": free}
    walls = dict.fromkeys("abd", "infinite")
    place = [[4.5 * D, 4.5 * D]]
    assert held_in(box, {**walls, "press": "infinite"}, place, **changes).has_piston_wall
    with pytest.raises(SceneError, match=r"add effects\.walls\.press"):
        held_in(box, {**walls, "press": "none"}, place, **changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cell.sides": polygon(SQUARE[::-1])}, "make the cell convex"),
        ({"cell.sides.0.name": "piston"}, "'piston' is already the name of another recorded force"),
        ({"cell.sides": polygon(SQUARE + D)}, "shift all corners by -0.006, -0.006 m"),
        ({"cell.width": "9 D"}, "is computed from the sides"),
        ({"cell.sides": [{"name": "a", "ends": [[0.0, 0.0]]}]}, "not two different points"),
        ({"effects.walls": {"lid": "infinite"}}, "unknown side 'lid'"),
        ({"effects.walls.a": {"law": "slab", "length": "9 D"}}, "is not allowed at this side"),
        ({"effects.walls": {"a": "infinite", "b": "none", "c": "slab", "d": "none"}}, "close the opening"),
        ({"effects.walls.a": {"law": "slab", "gap_start": "8 D", "gap_end": "10 D"}}, "exceeds the length"),
    ],
)
def test_invalid_cell_sides_are_an_error(changes: dict[str, Any], words: str) -> None:
    scene = held_in(polygon(SQUARE), dict.fromkeys("abcd", "infinite"), [[4.5 * D, 4.5 * D]])
    with pytest.raises(SceneError) as caught:
        scene.replace(**changes)
    assert words in str(caught.value)
