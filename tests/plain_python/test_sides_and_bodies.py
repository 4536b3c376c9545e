"""Several pistons at different heights, and inclined sides, in runs, equilibria, pictures and exports."""

from pathlib import Path
from typing import Any

import gsd.hoomd
import meshio
import numpy as np
import pytest
from matplotlib.figure import Figure

from granular import Scene, evaluate, simulate
from granular.export import to_extxyz, to_gsd, to_vtk
from granular.linear import motion_friction, slopes
from granular.linear.equilibrium import equilibrium, equilibrium_from
from granular.observables.forces import wall_branches_and_forces
from granular.observables.frame import frame_at
from granular.render import picture
from granular.run.trajectory import Trajectory
from granular.scene.bed_drawing import draw_bed
from granular.shared.errors import InputError
from granular.studies.bed_slopes import equilibrium_state
from granular.studies.tolerances import read_part_tolerances, tolerances_at

D = 6e-3


def scene_of(sides: list[dict[str, Any]], places: list[list[float]], **changes: Any) -> Scene:
    """Return a scene of dipoles in a cell of infinite walls, under a free piston of 0.2 kg."""
    plain = {
        "grains": {"count": len(places), "species": [{"diameter": D}]},
        "cell": {"sides": sides},
        "piston": {"height": 8.0 * D, "mass": 0.2, "drag": 6.0},
        "effects": {
            "dipole": True,
            "walls": {side["name"]: side.pop("law", "infinite") for side in sides},
            "gravity": True,
            "drag": {"coefficient": 0.2},
        },
        "arrangement": {"positions": places},
        "protocol": [{"name": "settle", "kind": "free", "duration": 0.6}],
        "output": {"scalars": 2e-3, "frames": 0.1},
    }
    parts = plain | {key: part for key, part in changes.items() if "." not in key}
    more = {key: value for key, value in changes.items() if "." in key}
    return Scene.from_plain({key: part for key, part in parts.items() if part is not None}).replace(**more)


def box(names: str = "lbrt") -> list[dict[str, Any]]:
    wide, tall = 8.0 * D, 30.0 * D
    ends = [[[0.0, tall], [0.0, 0.0]], [[0.0, 0.0], [wide, 0.0]], [[wide, 0.0], [wide, tall]]]
    ends.append([[wide, 0.0], [0.0, 0.0]])
    sides: list[dict[str, Any]] = [{"name": n, "ends": e} for n, e in zip(names, ends, strict=True)]
    sides[3]["body"] = "piston"
    return sides


GRID = [[(1.2 + 2.5 * i + 0.4 * j) * D, (1.5 + 2.0 * j) * D] for j in range(2) for i in range(3)]
FLOOR = {
    "mount": "base",
    "pistons": [{"name": "floor", "mass": 0.3, "side": "b", "drag": 20.0}],
    "springs": [{"upper": "floor", "stiffness": 2000.0, "preload": 8.0}],
}


@pytest.fixture(scope="module")
def two_pistons() -> Trajectory:
    """Return a settled bed on a spring-supported floor, 2 mm above the floor's initial height."""
    return simulate(scene_of(box(), GRID, **{"effects.host": FLOOR}), dt=4e-4, progress=False)


def test_wall_forces_are_evaluated_at_the_height_of_each_piston(two_pistons: Trajectory) -> None:
    frame, scene = frame_at(two_pistons), two_pistons.scene
    assert frame.heights[1] == two_pistons.dataset["floor_displacement"].values[-1]
    assert frame.heights[1] > 1e-3
    parts = wall_branches_and_forces(scene, frame.positions, frame.heights)
    whole = evaluate(scene, frame.positions, piston_height=frame.heights)
    outwards = [
        -parts.forces[:, k].sum(axis=0) @ -np.array(line.normal) for k, line in enumerate(scene.cell.lines)
    ]
    np.testing.assert_allclose(list(whole.wall_forces.values()), outwards, rtol=1e-12)
    record = two_pistons.dataset
    np.testing.assert_allclose(whole.wall_forces["b"], record["b_force"].values[-1], rtol=1e-9)
    places = frame.positions[:, 1] - frame.heights[1]
    np.testing.assert_allclose(parts.branches[:, 1, 1], places, rtol=1e-12)
    with pytest.raises(InputError, match="'b' moves with a further piston; pass the height"):
        wall_branches_and_forces(scene, frame.positions, frame.piston_height)
    with pytest.raises(InputError, match="piston_height = "):
        evaluate(scene, frame.positions, piston_height=[0.05, 0.0, 0.0])  # type: ignore[arg-type]


def test_pictures_show_each_piston_at_its_height(two_pistons: Trajectory) -> None:
    frame, scene = frame_at(two_pistons), two_pistons.scene
    axes = Figure().subplots()
    draw_bed(axes, scene, frame.positions, frame.heights)
    levels = {round(float(line.get_ydata()[0]), 9) for line in axes.lines if np.ptp(line.get_ydata()) == 0.0}
    assert levels == {round(1e3 * float(height), 9) for height in frame.heights}
    drawn = picture.BedPicture(two_pistons, "species", (0.0, 1.0), 8.0 * D)
    drawn.show_frame(frame)
    inner = [float(np.min(patch.get_xy()[:2, 1])) for patch, *_ in drawn._pistons]
    np.testing.assert_allclose(sorted(inner), sorted(1e3 * frame.heights))


def test_sensitivities_and_tolerances_use_the_equilibrium_height_of_each_piston(
    two_pistons: Trajectory,
) -> None:
    rest = equilibrium(two_pistons)
    np.testing.assert_allclose(rest.heights, frame_at(two_pistons).heights, rtol=0.02)
    state = equilibrium_state(two_pistons)
    again = equilibrium_from(two_pistons.scene, np.array(state["positions"]), np.array(state["height"]))
    np.testing.assert_allclose(again.heights, rest.heights, atol=1e-12)
    keys = ("piston.mass", "grains.remanence")
    found = slopes(rest, keys)
    np.testing.assert_allclose(found.values[:, 0], by_differences(rest, keys), rtol=1e-4)
    moved = tolerances_at([rest], read_part_tolerances(rest.scene, {"piston.mass": "0.1%"}))
    np.testing.assert_allclose(moved.slopes[0, 0], found.values[0], rtol=1e-3, atol=1e-4)
    assert motion_friction(rest, static=0.1).load > 0.0


def by_differences(rest: Any, keys: tuple[str, ...], step: float = 1e-4) -> list[float]:
    """Return the sensitivity d ln(result)/d ln(value) from equilibria of changed scenes."""
    result = []
    for key in keys:
        heights = []
        for sign in (1.0, -1.0):
            number = rest.scene.piston.mass if key == "piston.mass" else rest.scene.grains.remanence
            changed = rest.scene.replace(**{key: number * (1.0 + sign * step)})
            after = equilibrium_from(changed, rest.positions, rest.heights)
            heights.append(np.log(after.piston_height))
        result.append((heights[0] - heights[1]) / (2.0 * step))
    return result


def test_sensitivities_of_a_bed_on_inclined_sides_agree_with_finite_differences() -> None:
    """A piston rests on magnets between two sides of 30 and 45 degrees and a short floor."""
    tall, wide = 8.0 * D, 4.0 * D
    left, right = tall / np.tan(np.pi / 4.0), tall / np.tan(np.pi / 6.0)
    corners = [[0.0, tall], [left, 0.0], [left + wide, 0.0], [left + wide + right, tall]]
    sides: list[dict[str, Any]] = [
        {"name": name, "ends": [corners[k], corners[k + 1]]} for k, name in enumerate(("l", "b", "r"))
    ]
    sides.append({"name": "t", "ends": [[left + wide, 0.0], [left, 0.0]], "body": "piston"})
    middle = left + 0.5 * wide
    places = [[middle + (1.7 * i + 0.3 * j) * D, (1.5 + 1.6 * j) * D] for j in range(2) for i in (-1, 0, 1)]
    scene = scene_of(sides, places, **{"piston.height": 6.0 * D})
    rest = equilibrium(simulate(scene, dt=4e-4, progress=False))
    assert rest.is_stable
    keys = ("piston.mass", "grains.remanence")
    np.testing.assert_allclose(slopes(rest, keys).values[:, 0], by_differences(rest, keys), rtol=1e-4)


def test_exports_of_a_polygonal_cell_omit_grains_after_they_have_left(tmp_path: Path) -> None:
    """Grains leave through a hole in the floor under a lid."""
    sides = box()
    sides[1] |= {"law": "slab", "ends": [[0.0, 0.0], [1.5 * D, 0.0]]}
    sides[2:2] = [{"name": "c", "law": "slab", "ends": [[6.5 * D, 0.0], [8.0 * D, 0.0]]}]
    sides[-1] = {"name": "t", "ends": [[8.0 * D, 30.0 * D], [0.0, 30.0 * D]]}
    hold = [{"name": "fall", "kind": "hold", "duration": 0.2}]
    scene = scene_of(sides, GRID, **{"piston": None, "protocol": hold})
    run = simulate(scene, dt=4e-4, progress=False)
    data = run.dataset
    here = np.isfinite(data["position"].values[..., 0])
    counts = here.sum(axis=1).tolist()
    assert counts[0] == len(GRID) > counts[-1]
    last, places = len(counts) - 1, data["position"].values[-1][here[-1]]
    lines = to_extxyz(run, tmp_path / "out.xyz").read_text(encoding="utf-8").splitlines()
    rows = np.array([line.split()[1:3] for line in lines[-counts[-1] :]], dtype=float)
    np.testing.assert_array_equal(rows, places)
    assert f'Lattice="{8.0 * D:.17g} 0 0' in lines[1]
    with gsd.hoomd.open(str(to_gsd(run, tmp_path / "out.gsd"))) as file:
        assert [frame.particles.N for frame in file] == counts
        np.testing.assert_array_equal(file[last].log["particles/position"][:, :2], places)
        half = 0.5 * np.array(file[last].configuration.box[:2])
        assert (np.abs(file[last].particles.position[:, :2]) <= half).all()
    meshes = [meshio.read(path) for path in to_vtk(run, tmp_path / "vtk")[1:]]
    assert [len(mesh.points) for mesh in meshes] == counts
    np.testing.assert_array_equal(meshes[-1].points[:, :2], places)
