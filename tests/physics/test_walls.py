"""The wall laws: energy and force, limits, the tangential part, and beds on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import Scene, Trajectory, evaluate, load_scene, simulate
from granular.compiled import entry
from granular.effects import wall_experimental, wall_infinite, wall_slab
from granular.shared.errors import SceneError

LENGTH = 10.0


def difference(function: Callable[..., Any], *place: float, axis: int) -> float:
    """Derivative by mpmath, to many digits."""
    with mpmath.workdps(90):
        point = [mpmath.mpf(one) for one in place]

        def along(value: Any) -> Any:
            moved = [*point]
            moved[axis] = value
            return function(*moved)

        return float(mpmath.diff(along, point[axis], h=mpmath.mpf(10) ** -30))


def slab_energy(w: Any, s: Any) -> Any:
    """The slab's energy as it is written, for any precision."""
    a, b = s, LENGTH - s
    return (a / mpmath.sqrt(w * w + a * a) + b / mpmath.sqrt(w * w + b * b)) / (4 * w * w)


@settings(max_examples=150, deadline=None)
@given(w=st.floats(-4.0, 1.5).map(lambda one: 10.0**one), s=st.floats(-15.0, 25.0))
def test_slab_force_is_minus_gradient(w: float, s: float) -> None:
    """Normal and tangential force, above the slab and beyond its ends, close to the line too."""
    a, b = s, LENGTH - s
    with mpmath.workdps(60):
        energy = float(slab_energy(mpmath.mpf(w), mpmath.mpf(s)))
    if min(abs(a), abs(b)) < 1e-6:
        return
    assert wall_slab.energy(w, a, b) == pytest.approx(energy, rel=1e-12)
    normal = -difference(slab_energy, w, s, axis=0)
    tangential = -difference(slab_energy, w, s, axis=1)
    scale = abs(wall_slab.normal_force(w, a, b)) + abs(tangential)
    assert wall_slab.normal_force(w, a, b) == pytest.approx(normal, rel=1e-7, abs=1e-9 * scale)
    assert wall_slab.tangential_force(w, a, b) == pytest.approx(tangential, rel=1e-7, abs=1e-9 * scale)


def test_slab_force_is_the_sources_above_it() -> None:
    """[D, eq. 3.17] with A = w/(f L), B = w/((1 - f) L)."""
    w, s = 1.3, 3.7
    a, b = w / s, w / (LENGTH - s)
    wanted = 0.75 / w**3 * sum((3 * k**2 + 2) / (3 * k**2 + 3) / np.sqrt(k**2 + 1) for k in (a, b))
    assert wall_slab.normal_force(w, s, LENGTH - s) == pytest.approx(wanted, rel=1e-14)


def test_slab_tends_to_the_infinite_wall() -> None:
    for w in (0.3, 1.0, 4.0):
        errors = [
            abs(wall_slab.normal_force(w, half, half) / wall_infinite.force(w) - 1.0)
            for half in (10.0, 100.0, 1000.0)
        ]
        assert errors[0] > errors[1] > errors[2]
        assert errors[2] < 1e-9
        assert wall_slab.energy(w, 1e6, 1e6) == pytest.approx(wall_infinite.energy(w), rel=1e-10)


@pytest.mark.parametrize("law", [wall_experimental, wall_infinite])
@pytest.mark.parametrize("w", [0.1, 1.0, 7.0])
def test_simple_laws(law: ModuleType, w: float) -> None:
    h = 1e-4 * w
    slope = (law.energy(w - h) - law.energy(w + h)) / (2.0 * h)
    assert law.force(w) == pytest.approx(slope, rel=1e-6)
    curve = (law.force(w - h) - law.force(w + h)) / (2.0 * h)
    assert law.stiffness(w) == pytest.approx(curve, rel=1e-6)
    speed = 0.4
    near = law.turning_stiffness(speed)
    distances = np.geomspace(0.2, 20.0, 20000)
    turn = distances[np.argmin([abs(law.energy(one) - 0.5 * speed**2) for one in distances])]
    assert near == pytest.approx(law.stiffness(turn), rel=0.01)


def test_stiffest_turn_at_a_slab_is_that_at_its_end() -> None:
    """A grain of that speed turns there where half the infinite wall's energy stops it."""
    speed, far = 0.4, 1e6
    distances = np.geomspace(0.2, 20.0, 20000)
    energies = [wall_slab.energy(one, 0.0, far) for one in distances]
    turn = distances[np.argmin(np.abs(np.array(energies) - 0.5 * speed**2))]
    slab = wall_slab.SlabWall(np.array([0.0]), np.array([LENGTH]), True)
    found = entry(wall_slab.SlabWall.turning_stiffness)(slab, speed)
    assert found == pytest.approx(wall_infinite.stiffness(turn), rel=0.01)


def walled(law: str, **more: object) -> Scene:
    """The damper's bed with slabs or other walls on all sides."""
    side = {"law": law, **({"length": "75 D"} if law == "slab" else {})}
    walls = {"left": side, "right": side, "bottom": {"law": law}, "top": {"law": law}}
    return load_scene("bed").replace(**{"effects.walls": walls, **more})


@pytest.mark.parametrize("law", ["infinite", "slab"])
def test_scene_force_is_minus_gradient(law: str) -> None:

    scene = walled(law, **{"effects.dipole": None, "effects.gravity": None})
    positions = scene.initial_motion()[0]
    force = evaluate(scene, positions).force
    step = 2e-4 * 0.006
    for grain, axis in ((0, 0), (0, 1), (33, 0), (200, 1), (367, 0), (367, 1)):
        energies = []
        for shift in (-2, -1, 1, 2):
            moved = positions.copy()
            moved[grain, axis] += shift * step
            energies.append(evaluate(scene, moved).potential_energy)
        slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * step)
        assert -slope == pytest.approx(force[grain, axis], rel=1e-7, abs=1e-7 * np.abs(force).max())


@pytest.mark.long  # quick: ledgers in plain Python
@pytest.mark.parametrize("law", ["infinite", "slab"])
def test_energy_is_kept_between_the_walls(law: str) -> None:
    # No drag, by its coefficient: the bed at rest on slabs is then compiled code already.
    scene = walled(law, **{"effects.drag.coefficient": 0.0, "grains.count": 60})
    run = simulate(scene, dt=1e-5, t_end=0.3, progress=False)
    assert run.settings()["ledger_residual"] < 1e-4


def test_the_bed_that_the_source_could_not_hold_up_rests_on_slabs() -> None:
    """[D, 3.6]: with slabs the source's bed fell through the bottom. Here it settles."""
    scene = walled(
        "slab",
        **{
            "protocol.settle.until": "rest",
            "protocol.settle.duration": 20.0,
            "protocol.settle.tolerance": "1e-3 D",
        },
    )
    run = simulate(scene, progress=False)
    assert run.stages[0].reason == "rest"
    height = run.dataset["position"].values[-1, :, 1]
    assert (height > 0.0).all()
    weight = 368 * 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0 * 9.8
    lift = run.dataset["bottom_force"].values[-1] - run.dataset["piston_force"].values[-1]
    side = evaluate(scene, run.dataset["position"].values[-1]).force
    assert np.abs(side).max() < 2e-3 * run.dataset["bottom_force"].values[-1]
    assert lift == pytest.approx(weight, rel=0.15)


@pytest.mark.parametrize(
    ("walls", "words"),
    [
        ({"left": "slab"}, "effects.walls.left.length: must be given"),
        ({"left": {"law": "slab", "length": -1}}, "above 0 m"),
        ({"bottom": {"law": "infinite", "length": 0.1}}, "only a slab has a length"),
        ({"top": {"law": "slab", "gap_start": 0.1, "gap_end": 0.2}}, "only the bottom"),
        ({"bottom": {"law": "slab", "gap_start": 0.1}}, "both ends of the gap"),
        ({"bottom": {"law": "slab", "gap_start": 0.2, "gap_end": 0.1}}, "above gap_start"),
        ({"bottom": {"law": "experimental", "gap_start": 0.1, "gap_end": 0.2}}, "only a slab"),
    ],
)
def test_bad_walls(bed: Scene, walls: dict, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        bed.replace(**{"effects.walls": walls})
    assert words in str(caught.value)


RUBBING = {
    "grains.species": [
        {"name": "big", "diameter": 0.006, "share": 0.5},
        {"name": "small", "diameter": 0.004, "share": 0.5},
    ],
    "effects.friction": {},
    "effects.drag": None,
}
"""Two species that rub: all that a grain that leaves takes with it."""


@pytest.fixture(
    scope="module",
    params=[
        # The walls of the beds above, so that they share compiled code.
        pytest.param({"effects.walls": None}, id="slabs all around"),
        pytest.param(RUBBING, id="two species that rub", marks=pytest.mark.long),
    ],
)
def silo(request: pytest.FixtureRequest) -> Scene:
    """Two slabs with a gap."""
    bottom = {"law": "slab", "gap_start": "6 D", "gap_end": "14 D"}
    changes = dict(request.param)
    if "effects.walls" in changes:
        side = {"law": "slab", "length": "20 D"}
        changes["effects.walls"] = {"left": side, "right": side, "top": "slab", "bottom": bottom}
    else:
        changes["effects.walls.bottom"] = bottom
    return load_scene("bed").replace(
        **{
            "grains.count": 40,
            "cell.width": "20 D",
            "piston.height": "14 D",
            "arrangement.height": "13 D",
            "output.frames": 0.01,
            **changes,
        }
    )


@pytest.fixture(scope="module")
def flow(silo: Scene) -> Trajectory:
    return simulate(silo, dt=5e-5, t_end=0.6, progress=False)


def test_silo_grains_flow_out_and_are_counted(flow: Trajectory) -> None:
    """Grains that leave are taken out, the others keep their identity."""
    count = flow.dataset["grain_count"].values
    assert count[0] == 40
    assert 5 < count[-1] < 35
    assert (np.diff(count) <= 0).all()
    place = flow.dataset["position"].values
    gone = np.isnan(place[:, :, 0])
    assert gone[-1].sum() == 40 - count[-1]
    assert (np.diff(gone.astype(int), axis=0) >= 0).all()
    for grain in np.flatnonzero(gone[-1]):
        before = np.flatnonzero(~gone[:, grain])[-1]
        assert place[before, grain, 1] < 0.0
    stays = np.flatnonzero(~gone[-1])
    steps = np.linalg.norm(np.diff(place[:, stays], axis=0), axis=2)
    assert steps.max() < 0.01
    assert flow.settings()["ledger_residual"] < 1e-2


def test_silo_resumes_to_the_same_bits(silo: Scene, flow: Trajectory, tmp_path: Path) -> None:
    for stop in (0.1123, 0.4, 0.6):
        run = simulate(silo, dt=5e-5, t_end=stop, out=tmp_path / "run", resume=True, progress=False)
    for name in flow.dataset:
        assert np.array_equal(flow.dataset[name].values, run.dataset[name].values, equal_nan=True), name
