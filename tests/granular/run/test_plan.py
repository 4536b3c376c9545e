"""Validation of the settings of a run before it starts, and the choice of its number of threads."""

import math
from typing import Any

import numba
import pytest

from granular import Scene, effect, load_scene, plan, simulate
from granular.methods import METHODS
from granular.run.plan import (
    ThreadCountTuner,
    can_run,
    choose_thread_count,
    parse_time_step,
    scaled_time_step_setting,
)
from granular.scene.scene import dry_friction_parts
from granular.shared.errors import InputError, StepCountError


@effect
class OwnFlow:
    """Custom drag, defined as an exactly solved dissipation."""

    @staticmethod
    def flow(p: Any, grain: Any, vx: float, vy: float, dt: float) -> tuple[float, float]:
        return math.exp(-dt) * vx, math.exp(-dt) * vy


CONTACT = {"effects.contact": {"modulus": 1e7}}


@pytest.mark.parametrize(
    ("changes", "dry"),
    [
        ({}, ()),
        ({"effects.friction": {}}, ("friction",)),
        ({"effects.friction": {}, **CONTACT}, ("friction", "contact")),
        ({"piston.friction": 0.1}, ()),  # the bed's piston has no mass: it is never free
        ({"piston.friction": 0.1, "piston.mass": 1.0}, ("piston.friction",)),
        ({"piston": None, "effects.walls.top": None, "arrangement.height": 0.03}, ()),
    ],
)
def test_effects_of_a_scene_that_include_dry_friction_are_found(
    small_bed: Scene, changes: dict[str, Any], dry: tuple[str, ...]
) -> None:
    assert dry_friction_parts(small_bed.replace(**changes)) == dry


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"effects.friction": {}},
        CONTACT,
        {"piston.friction": 0.1, "piston.mass": 1.0},
        {"effects.walls.top": {"law": "slab"}},
    ],
)
def test_every_invalid_combination_of_step_method_and_scene_is_refused_before_compilation(
    small_bed: Scene, changes: dict[str, Any]
) -> None:
    """The scene's protocol also has no end; this error is reported only if everything else is valid."""
    endless = small_bed.replace(**changes, protocol=[{"kind": "hold", "name": "wait"}])
    seen = set()
    for method in (*METHODS, "stormer-verlet+compensated"):
        for dt in ("auto", "auto*4", 1e-4):
            allowed = can_run(endless, dt, method)
            seen.add(allowed)
            with pytest.raises(InputError) as refused:
                simulate(endless, dt=dt, method=method, progress=False)
            assert ("has no end" in str(refused.value)) == allowed
    assert seen == {True, False}


FREE_PISTON = {"piston.mass": 1.0, "effects.drag": None}
PLATE = {"conductivity": 1e6, "thickness": 1e-3, "distance": 4e-3}
BODY = {"mass": 1.0, "stiffness": 100.0}


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({}, "drag"),
        ({"effects.drag": None}, None),
        ({"effects.drag": None, "effects.friction": {}}, "friction"),
        ({"effects.drag": None, "effects.wall_friction": {"coefficient": 0.3}}, "wall_friction"),
        ({"effects.drag": None, **CONTACT}, "contact"),
        ({"effects.drag": None, "effects.eddy": PLATE}, "eddy"),
        ({"effects.drag": None, "effects.bath": {"temperature": 1e-9, "rate": 1.0}}, "bath"),
        ({"effects.drag": None, "effects.shaking": {"amplitude": 1e-3, "frequency": 1.0}}, None),
        ({"effects.drag": None, "effects.own_flow": {}}, "own_flow"),
        ({"effects.drag": None, "piston.drag": 1.0}, None),  # without a mass it is never free
        ({**FREE_PISTON, "piston.drag": 1.0}, "piston.drag"),
        ({**FREE_PISTON, "piston.friction": 0.1}, "piston.friction"),
        ({**FREE_PISTON, "effects.host": {"bodies": [BODY]}}, "host"),
        ({**FREE_PISTON, "effects.host": {"bodies": [{**BODY, "damping": 1.0}]}}, "host"),
    ],
)
def test_runge_kutta_methods_accept_only_effects_that_are_forces(
    small_bed: Scene, changes: dict[str, Any], part: str | None
) -> None:
    scene = small_bed.replace(**changes)
    for method in ("explicit-euler", "runge-kutta-4"):
        assert can_run(scene, "auto", method) == (part is None)
        if part is not None:
            with pytest.raises(InputError) as refused:
                simulate(scene, method=method, progress=False)
            assert f"cannot run a scene with {part!r}" in str(refused.value)
            assert "use 'stormer-verlet'" in str(refused.value)


def test_multiples_of_the_automatic_step_are_limited_by_stability(small_bed: Scene) -> None:
    """With Coulomb friction and without contacts, the automatic step is already four times as long as in
    other scenes.
    """
    rubbing = small_bed.replace(**{"effects.friction": {}})
    assert can_run(small_bed, "auto*8", "stormer-verlet")
    assert can_run(rubbing, "auto*2", "stormer-verlet")
    assert not can_run(rubbing, "auto*4", "stormer-verlet")
    regularised = rubbing.replace(**{"effects.friction.scheme": "regularised"})
    assert can_run(regularised, "auto*8", "stormer-verlet")
    assert can_run(rubbing.replace(**CONTACT), "auto*8", "stormer-verlet")


@pytest.mark.parametrize("dt", ["auto", "auto*2", "auto/3", "auto*1.5", 1e-5])
def test_a_step_setting_that_is_halved_and_doubled_is_unchanged(dt: float | str) -> None:
    halved_and_doubled = scaled_time_step_setting(scaled_time_step_setting(dt, 0.5), 2.0)
    step, back = parse_time_step(dt), parse_time_step(halved_and_doubled)
    assert back.seconds == step.seconds
    assert back.factor == pytest.approx(step.factor, rel=1e-15)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": 1e10}, "longer than the time between records, output.scalars = 0.001 s"),
        ({"dt": 1.001e-3}, "longer than the time between records"),
        ({"dt": 5e-4, "t_end": 4e-4}, "longer than the run, t_end = 0.0004 s"),
        ({"dt": 1e-14}, "makes 1e+11 steps between records, but the limit is 1e+10"),
        ({"t_end": True}, "t_end = True is outside the limits; give a time above 0 s"),
        ({"dt": True}, "dt = True is not a time step; give"),
        ({"t_end": 1e308}, "up to 1e+30 s"),
    ],
)
def test_time_steps_and_end_times_outside_their_limits_are_refused(
    arguments: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        simulate(load_scene("single-particle"), progress=False, **arguments)
    assert words in str(caught.value)


def test_steps_longer_than_a_stage_are_refused(small_bed: Scene) -> None:
    """The duration of a stage is given, or follows from heights and a speed or from a table of heights."""
    hold = {"kind": "hold", "name": "wait", "duration": 0.01}
    for short in (
        {"kind": "hold", "name": "short", "duration": 1e-4},
        {"kind": "move", "name": "short", "to": "5.9998 D", "speed": "1 D/s"},
        {"kind": "follow", "name": "short", "times": [0.0, 1e-4], "heights": ["6 D", "6 D"]},
    ):
        scene = small_bed.replace(**{"protocol": [hold, short, {**hold, "name": "after"}]})
        assert can_run(scene, 1e-4, "stormer-verlet")
        with pytest.raises(InputError, match=r"dt = 0\.0005 s is longer than stage 'short'"):
            simulate(scene, dt=5e-4, progress=False)


@pytest.mark.parametrize(
    ("changes", "arguments"),
    [
        ({"grains.remanence": 1e-30}, {}),
        ({"grains.remanence": 1e30}, {}),
        ({"grains.remanence": 1e30}, {"method": "adaptive-verlet"}),
        ({"grains.species.0.diameter": 1e-29}, {}),
        ({"output.scalars": 1e-29, "output.frames": 1e-29}, {}),
        ({"output.scalars": 1e29, "output.frames": 1e29}, {}),
        ({}, {"t_end": 1e30}),
    ],
)
def test_runs_with_too_many_time_steps_are_refused(
    changes: dict[str, Any], arguments: dict[str, Any]
) -> None:
    with pytest.raises(StepCountError, match="the limit is") as caught:
        simulate(load_scene("single-particle").replace(**changes), progress=False, **arguments)
    assert caught.value.step == 0


@pytest.mark.parametrize("end", [1e-12, 1e-300])
def test_a_run_or_stage_that_ends_within_the_first_step_reaches_its_end(end: float) -> None:
    scene = load_scene("single-particle")
    run = simulate(scene, t_end=end, progress=False)
    assert (run.complete, run.settings()["steps"]) == (True, 1)
    assert run.dataset["time"].values[-1] == pytest.approx(end, rel=1e-12)
    run = simulate(scene.replace(**{"protocol.0.duration": 1e-12}), progress=False)
    assert run.stages[-1].end == pytest.approx(1e-12, rel=1e-12)


def test_start_times_of_record_intervals_are_exact_although_intermediate_products_exceed_64_bits() -> None:
    from granular.compiled import entry
    from granular.engine.step_size import StepRequest, step_count_of_tick, tick_start_time

    start, steps = entry(tick_start_time), entry(step_count_of_tick)
    schedule = StepRequest(seconds=1.0).divide_stage_into_steps(
        record=7.7e9, frame=7.7e9, frequency=1.0, tau=1.0
    )
    for tick in (0, 3, 10**9, 10**12):
        exact = tick * schedule.given // schedule.every
        assert start(schedule, tick) == exact * schedule.h
        assert steps(schedule, tick) == (tick + 1) * schedule.given // schedule.every - exact


def test_a_plan_that_is_run_twice_gives_bit_identical_runs(small_bed: Scene) -> None:
    chosen = plan(small_bed, 1e-4, t_end=0.01, threads=1)
    runs = [simulate(chosen, progress=False), simulate(chosen, progress=False)]
    runs.append(simulate(small_bed, 1e-4, 0.01, threads=1, progress=False))
    for run in runs:
        assert run.dataset.equals(runs[0].dataset)
    with pytest.raises(InputError, match="give them to plan"):
        simulate(chosen, t_end=0.02, progress=False)
    with pytest.raises(InputError, match="'pefrl' cannot run a scene with friction"):
        simulate(plan(small_bed.replace(**{"effects.friction": {}}), method="pefrl"), progress=False)


TWO = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one processor")


def heard(found: ThreadCountTuner, seconds: dict[int, float], calls: int) -> list[int]:
    """Return the numbers of threads chosen in successive calls for given times per step."""
    taken = []
    for _ in range(calls):
        taken.append(found.count)
        found.note_step_time_and_choose_count(10, 10 * seconds[found.count])
    return taken


@TWO
@pytest.mark.parametrize(("slow", "quick"), [(1, 2), (2, 1)])
def test_faster_number_of_threads_is_chosen(slow: int, quick: int) -> None:
    """One and two threads are tried in short calls, and the faster number is kept."""
    found = ThreadCountTuner(2)
    assert found.trying
    taken = heard(found, {slow: 5e-4, quick: 1e-4}, 6)
    assert set(taken[:2]) == {1, 2}
    assert taken[2:] == [quick] * 4
    assert not found.trying
    assert numba.get_num_threads() == quick


def test_a_run_limited_to_one_thread_keeps_one_thread() -> None:
    found = ThreadCountTuner(1)
    assert heard(found, {1: 1.0}, 3) == [1, 1, 1]
    assert not found.trying


@pytest.fixture(scope="module")
def large(bed: Scene) -> Scene:
    return bed.replace(
        **{"grains.count": 2000, "cell.width": "140 D", "piston.height": "62 D", "arrangement.height": "60 D"}
    )


def test_small_beds_and_verlet_lists_use_one_thread(bed: Scene, large: Scene) -> None:
    assert choose_thread_count(bed, None) == 1
    assert choose_thread_count(large.replace(**{"pairs.method": "verlet-list"}), None) == 1
    assert choose_thread_count(large, 1) == 1


@TWO
@pytest.mark.parametrize("method", ["cut-off", "mesh", "direct"])
def test_large_beds_use_several_threads(large: Scene, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "THREADING_LAYER", "workqueue")
    assert (choose_thread_count(large.replace(**{"pairs.method": method}), None) > 1) == (method == "direct")
