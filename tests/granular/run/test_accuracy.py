"""Runs with a requested accuracy: chosen methods and steps, measured error bounds, refusals, and the
printed cost.
"""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numba.core.compiler_lock import global_compiler_lock

import granular.run.engines
import granular.run.simulation
from granular import Scene, damper, load_scene, plan, simulate
from granular.run import work_precision
from granular.run.plan import MESH_PAYS_FROM, SCATTER, parse_time_step, parse_tolerance_and_quantity
from granular.run.summary import run_text
from granular.run.work_precision import (
    FLOORS,
    MARGIN,
    SceneWorkPrecision,
    WorkPrecisionEntry,
    load_work_precision_scenes,
    most_similar_measured_scene,
    store_measured_scene,
    work_precision_text,
)
from granular.shared.errors import InputError
from granular.shared.files import ResultCache


def of_table(one: SceneWorkPrecision) -> Scene:
    """Return a scene for an entry of the table of measured errors."""
    changes: dict[str, object] = {"grains.count": one.grains, "cell.width": "60 D"}
    if "rest height" in one.floors:
        changes |= {"piston.mass": 7.5, "protocol": [{"kind": "free", "name": "drop", "until": "rest"}]}
    if one.kind == "friction":
        changes |= {"effects.drag": None, "effects.friction": {}}
    return load_scene("bed").replace(**changes)


def promises() -> Iterator[object]:
    """Yield each measured scene with each of its measured quantities.

    Quick tests use one quantity per scene.
    """
    for one in load_work_precision_scenes():
        for k, quantity in enumerate(one.floors):
            marks = [pytest.mark.long] if k else []
            yield pytest.param(one, quantity, id=f"{one.name}: {quantity}", marks=marks)


@pytest.mark.parametrize(("costs", "quantity"), promises())
def test_method_and_step_chosen_for_an_accuracy_meet_the_tolerance_at_low_cost(
    costs: SceneWorkPrecision, quantity: str
) -> None:
    """The cost is at most 1.5 times the cost of the cheapest measured setting within the tolerance."""
    scene = of_table(costs)
    assert most_similar_measured_scene(scene, quantity) == costs
    chosen = 0
    for tolerance in (10.0 ** (-k / 4) for k in range(29)):
        accurate_points = [one for one in costs.entries if one.bounds[quantity] <= tolerance]
        if tolerance < FLOORS * costs.floors[quantity]:
            with pytest.raises(InputError, match="spread over random packings"):
                plan(scene, accuracy=f"{tolerance} {quantity}")
            continue
        if tolerance < MARGIN * min(one.bounds[quantity] for one in costs.entries):
            continue  # shorter than the table's shortest step, or refused
        found = plan(scene, accuracy=f"{tolerance} {quantity}")
        chosen += 1
        fraction = parse_time_step(found.dt, scene).step_times_frequency
        same = [one for one in costs.entries if one.method == found.method.name]
        near = min(same, key=lambda one: abs(math.log(one.fraction / fraction)))
        if accurate_points:
            price = near.seconds * near.fraction / fraction
            assert price <= 1.5 * min(one.seconds for one in accurate_points)
        if fraction <= near.fraction:
            assert near.bounds[quantity] <= tolerance or quantity in near.clear
    assert chosen


def test_requested_accuracies_are_parsed() -> None:
    assert parse_tolerance_and_quantity("1e-4 rest height") == (1e-4, "rest height")
    assert parse_tolerance_and_quantity(" 1 %  piston force") == (0.01, "piston force")
    for text, said in (
        ("rest height", "give an error above 0"),
        ("0 rest height", "above 0"),
        ("nan energy", "above 0"),
        ("1e999 energy", "above 0"),
        ("-1 energy", "above 0"),
        ("", "above 0"),
    ):
        with pytest.raises(InputError, match=said):
            parse_tolerance_and_quantity(text)
    with pytest.raises(InputError, match="did you mean 'rest height'"):
        plan(damper(), accuracy="1e-3 rest heigth")


def test_accuracies_that_cannot_be_guaranteed_are_refused(bed: Scene) -> None:
    with pytest.raises(InputError, match=r"spread over random packings is .*average over \d+ packings"):
        plan(damper(), accuracy="1e-7 rest height")
    with pytest.raises(InputError, match="have no scene like 'bed' with this quantity"):
        plan(bed.replace(**{"effects.contact": {"modulus": 1e7}}), accuracy="1 % piston force")
    for key in ("effects.walls.left", "effects.walls.bottom"):
        with pytest.raises(InputError, match="have no scene like 'bed' with this quantity"):
            plan(bed.replace(**{key: "none"}), accuracy="10 % piston force")
    with pytest.raises(InputError, match="omits pairs"):
        plan(bed.replace(**{"pairs.method": "cut-off"}), accuracy="10 % piston force")
    with pytest.raises(InputError, match="either accuracy, or dt and method"):
        simulate(bed, dt="auto/2", accuracy="10 % piston force", progress=False)


def test_errors_measured_by_a_user_extend_the_packaged_table(bed: Scene) -> None:
    """A measured error applies to the scene with any packing, for tolerances down to the measured bound."""
    touching = bed.replace(**{"effects.contact": {"modulus": "1 MPa"}})
    entry = WorkPrecisionEntry(VERLET, "auto*2", 0.2, 0.15, 1.0, {"piston force": 2e-3}, ["piston force"])
    floors = {"piston force": 1e-4}
    own = SceneWorkPrecision("mine", "drag", 368, 4, "auto/8", floors, (entry,), "2026-11-28", margin=1.0)
    store_measured_scene(touching, "piston force", None, own)
    found = plan(touching.replace(**{"arrangement.seed": 7}), accuracy="2e-3 piston force")
    assert (found.method.name, found.dt) == (VERLET, "auto*2")
    assert found.words.endswith("(mine, 4 starts, 2026-11-28)")
    for other in (touching.replace(**{"effects.contact.modulus": "2 MPa"}), bed):
        with pytest.raises(InputError, match=r"have no scene like 'bed'|spread over random packings is"):
            plan(other, accuracy="2e-3 piston force")
    with pytest.raises(InputError, match=r"spread over random packings is 0\.0001"):
        plan(touching, accuracy="2e-4 piston force")
    # The packaged table is used first, the user's table if the first does not reach the accuracy.
    store_measured_scene(bed, "piston force", None, own)
    assert plan(bed, accuracy="5 % piston force").words.endswith(" starts, 2026-11-22)")
    assert plan(bed, accuracy="2e-3 piston force").words.endswith("(mine, 4 starts, 2026-11-28)")


def test_a_user_table_of_measured_errors_that_cannot_be_written_causes_only_a_warning(
    bed: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(work_precision, "user_work_precision_table", lambda: ResultCache(tmp_path / "file"))
    with pytest.warns(UserWarning, match=r"the measurement is not stored: .*file"):
        store_measured_scene(bed, "energy", None, load_work_precision_scenes()[0])


def test_direct_pair_sum_replaces_the_mesh_sum_for_small_tolerances(bed: Scene) -> None:
    large = bed.replace(
        **{"grains.count": 2000, "cell.width": "150 D", "piston.height": "60 D", "arrangement.height": "58 D"}
    )
    assert large.pair_method == "mesh"
    rough, fine = (plan(large, accuracy=f"{one} rest height") for one in (0.2, 8e-4))
    assert (rough.scene.pair_method, fine.scene.pair_method) == ("mesh", "direct")
    assert "mesh sum" in rough.words
    assert "direct sum" in fine.words


def test_run_with_a_requested_accuracy_reports_its_settings_and_cost(small_bed: Scene) -> None:
    scene = small_bed.replace(**{"grains.count": 22})
    run = simulate(scene, t_end=0.002, accuracy="1e-3 energy", progress=False)
    words = run.settings()["accuracy"]
    assert words.startswith("energy to 0.001: ")
    assert run.settings()["dt"] in words
    assert work_precision_text(run).startswith("cost: ")
    assert "due to the step" in work_precision_text(run)
    assert "half the step" in work_precision_text(run)


def test_reported_cost_of_a_run_excludes_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, made = granular.run.engines.advance_ticks, iter(range(100))

    def advance(*known: Any) -> Any:
        if next(made) == 0:
            with global_compiler_lock, global_compiler_lock:
                time.sleep(1.2)
        return plain(*known)

    monkeypatch.setattr("granular.run.engines.advance_ticks", advance)
    started = time.perf_counter()
    run = simulate(load_scene("single-particle"), 1e-4, 0.05, progress=False)
    passed, settings = time.perf_counter() - started, run.settings()
    assert settings["compile_seconds"] >= 1.2
    assert 0.0 < settings["seconds"] <= passed - settings["compile_seconds"]
    assert f"cost: {settings['seconds']:.3g} s" in work_precision_text(run)
    assert f"{settings['compile_seconds']:.2g} s of compiling" in run_text(run)


def test_reported_cost_of_a_resumed_run_is_positive_if_restoring_it_compiles_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The cost was once negative for a run shorter than the compilation."""
    plain, scene = granular.run.simulation.restore_snapshot, load_scene("single-particle")

    def restore(*known: Any) -> None:
        with global_compiler_lock:
            time.sleep(0.5)
        plain(*known)

    simulate(scene, 1e-4, 0.05, out=tmp_path / "run", progress=False)
    monkeypatch.setattr(granular.run.simulation, "restore_snapshot", restore)
    run = simulate(scene, 1e-4, 0.06, out=tmp_path / "run", resume=True, progress=False)
    assert run.settings()["seconds"] > 0.0
    assert not work_precision_text(run).startswith("cost: -")


def test_cost_line_of_a_scene_without_measured_errors_reports_the_energy_residual() -> None:
    run = simulate(load_scene("single-particle"), 1e-4, 0.05, progress=False)
    error = run.settings()["ledger_residual"]
    assert f"energy to {error:.1g} due to the step" in work_precision_text(run)
    assert f", {error / 4.0:.1g}" in work_precision_text(run)


@pytest.mark.parametrize(("count", "dt"), [(368, "auto*4"), (92, "auto*2")])
def test_accuracy_set_to_scatter_selects_steps_with_errors_below_the_spread_over_packings(
    count: int, dt: str
) -> None:
    """In the measured table, a step of auto*4 changes the damping significantly for 92 grains, but not
    for 368.
    """
    assert plan(damper(count=count), accuracy=SCATTER).dt == dt


def test_accuracy_set_to_scatter_keeps_the_automatic_step_for_scenes_without_measured_errors() -> None:
    touching = damper().replace(**{"effects.contact": {"modulus": "1 MPa"}})
    assert plan(touching, accuracy=SCATTER).dt == "auto"
    assert plan(damper(), method="explicit-euler", accuracy=SCATTER).dt == "auto"


VERLET = "stormer-verlet"
MIXTURE = [
    {"name": "large", "diameter": "6 mm", "share": 0.7},
    {"name": "small", "diameter": "4 mm", "share": 0.3},
]
COPPER = {"conductivity": "58 MS/m", "thickness": "1 mm", "distance": "4 mm"}


@pytest.mark.parametrize(
    "changes",
    [{}, {"grains.species": MIXTURE}, {"cell.width": "70 D"}],
    ids=["damper", "two species", "another cell"],
)
def test_accuracy_set_to_scatter_selects_the_mesh_sum_if_two_runs_repay_its_compilation(
    changes: dict[str, Any],
) -> None:
    scene = damper(count=MESH_PAYS_FROM).replace(**changes)
    summed = plan(scene, accuracy=SCATTER, runs=2)
    assert summed.pair_sum == "mesh"
    assert summed.scene == scene.replace(**{"pairs.method": "mesh"})
    assert plan(scene, accuracy=SCATTER).pair_sum == "direct"  # one run does not pay for the compiling


@pytest.mark.parametrize(
    ("made", "changes", "method"),
    [
        ({"count": MESH_PAYS_FROM - 1}, {}, VERLET),
        ({"magnets": "cylinders"}, {"effects.contact": None}, VERLET),
        ({}, {"pairs.method": "direct"}, VERLET),
        ({}, {"pairs.far_every": 4}, VERLET),
        ({}, {"effects.contact": {"modulus": "1 MPa"}}, VERLET),
        ({}, {"effects.eddy": COPPER}, VERLET),
        ({}, {"effects.drag": None, "effects.friction": {}}, VERLET),
        ({}, {"effects.walls.left": "none"}, VERLET),
        ({}, {"cell.width": "1e5 D", "piston.height": "1e5 D"}, VERLET),
        ({}, {}, "pefrl"),
        ({}, {}, "stormer-verlet+compensated"),
        ({}, {}, "runge-kutta-4"),
        ({}, {}, "adaptive-verlet"),
    ],
    ids=str,
)
def test_accuracy_set_to_scatter_keeps_the_pair_sum_of_unsuitable_scenes_and_methods(
    made: dict[str, Any], changes: dict[str, Any], method: str
) -> None:
    scene = damper(**({"count": MESH_PAYS_FROM} | made)).replace(**changes)
    assert plan(scene, method=method, accuracy=SCATTER, runs=2).scene is scene


@pytest.mark.parametrize(("count", "method"), [(700, "mesh"), (800, "direct")])
def test_accuracy_set_to_scatter_selects_the_mesh_sum_only_if_its_error_is_small_enough(
    count: int, method: str
) -> None:
    """The error must be below the spread of results over random packings."""
    assert plan(damper(count=count), accuracy=SCATTER, runs=2).pair_sum == method
