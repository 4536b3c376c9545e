"""Motion of the piston in each kind of stage, user-defined stages, and ends of stages."""

import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, Trajectory, load_scene, quantity, simulate, stage
from granular.protocol.piston_motion import driven_height_and_velocity
from granular.protocol.stages import check_spline_stages
from granular.run.simulation import custom_code_digests
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, OutsideError, SceneError, StoreError
from granular.user_code import import_user_code_and_collect_measures
from tests.modes import quick_in_plain_python

D = 0.006


def run_protocol(scene: Scene, *stages: dict[str, object], **changes: object) -> Trajectory:
    run = scene.replace(**{"protocol": list(stages), "output.scalars": 1e-3, **changes})
    return simulate(run, progress=False)


def run_empty_cell(*stages: dict[str, object], **changes: object) -> Trajectory:
    """Simulate a piston above an empty cell, with the effects of the packaged damper, for which
    compiled code exists.
    """
    scene = load_scene("damper").replace(
        **{
            "grains.count": 0,
            "piston.mass": 2.0,
            "protocol": list(stages),
            "output.record": None,
            "output.scalars": 1e-3,
            "output.frames": 1e-2,
            **changes,
        }
    )
    return simulate(scene, dt=1e-5, progress=False)


def test_automatic_time_step_resolves_the_frequency_of_shaking() -> None:
    shaking = {"amplitude": 1e-5, "frequency": 2000.0}
    hold = {"kind": "hold", "name": "hold", "duration": 0.02}
    grain = load_scene("single-particle")
    drag = {"coefficient": 0.0}  # zero drag, to use the compiled code of other tests
    run = run_protocol(
        grain, hold, **{"effects.walls": None, "effects.shaking": shaking, "effects.drag": drag}
    )
    assert run.settings()["longest_step"] * 2.0 * math.pi * 2000.0 < 0.11


def test_frame_interval_is_kept_if_a_given_time_step_changes_the_record_interval(small_bed: Scene) -> None:
    scene = small_bed.replace(
        **{
            "protocol": [{"kind": "hold", "name": "hold", "duration": 0.4}],
            "output.scalars": 1e-3,
            "output.frames": 0.1,
            "grains.count": 1,
        }
    )
    with pytest.warns(UserWarning, match=r"records come every 0\.0007 s, not 0\.001 s"):
        run = simulate(scene, dt=7e-4, progress=False)
    assert run.dataset["frame_time"].values == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4], abs=1e-3)


@pytest.mark.parametrize("t_end", [None, 3.2e-3])
def test_end_of_a_stage_between_two_records_is_recorded(small_bed: Scene, t_end: float | None) -> None:
    """A stage of 160 steps ends between records, which are 352 steps apart."""
    last = {"kind": "hold", "name": "second", **({} if t_end else {"duration": 1.6e-3})}
    scene = small_bed.replace(
        **{
            "protocol": [{"kind": "hold", "name": "first", "duration": 1.6e-3}, last],
            "output": {"scalars": 3.52e-3, "frames": 3.52e-3},
        }
    )
    run = simulate(scene, 1e-5, t_end, progress=False)
    assert [result.end for result in run.stages] == pytest.approx([1.6e-3, 3.2e-3], rel=1e-9)
    assert run.dataset["time"].values == pytest.approx([0.0, 1.6e-3, 3.2e-3], rel=1e-9)


def test_piston_below_the_bottom_is_an_error() -> None:
    with pytest.raises(OutsideError, match="below the bottom"):
        run_empty_cell({"kind": "free", "name": "fall", "duration": 1.0})


@pytest.mark.parametrize(
    "table",
    [
        {"times": [0.0, 0.1], "heights": [0.036]},
        {"times": [0.0, 0.0], "heights": [0.036, 0.03]},
        {"times": [0.1, 0.0], "heights": [0.036, 0.03]},
        {"times": [], "heights": []},
        {"times": [0.0, 0.1], "heights": [0.036, -0.01]},
    ],
)
def test_invalid_table_of_piston_heights_is_an_error(small_bed: Scene, table: dict[str, object]) -> None:
    with pytest.raises(SceneError):
        run_protocol(small_bed, {"kind": "follow", "name": "table", **table})


def test_stage_that_should_end_at_a_force_ends_after_its_duration_if_the_force_is_not_reached(
    small_bed: Scene,
) -> None:
    stage = {"kind": "move", "name": "press", "to": "5.9 D", "speed": 0.05, "until_force": 1e3}
    run = run_protocol(small_bed, stage)
    assert run.stage("press").reason == "duration"
    assert run.stage("press").height == 5.9 * D


BARE = {"effects.dipole": None, "effects.drag": None, "effects.walls": None}
"""Minimal effects: a resistance of the piston requires a separate compilation of the loop."""


@quick_in_plain_python
def test_falling_piston_with_drag_follows_the_exact_solution() -> None:
    """V = -gT (1 - exp(-t/T)) with T = M/c."""
    run = run_empty_cell({"kind": "free", "name": "fall", "duration": 0.1}, **BARE, **{"piston.drag": 40.0})
    time, speed = (run.dataset[name].values for name in ("time", "piston_velocity"))
    assert speed == pytest.approx(-9.8 * 0.05 * -np.expm1(-time / 0.05), rel=1e-9)
    height = 0.12 - 9.8 * 0.05 * (time + 0.05 * np.expm1(-time / 0.05))
    assert run.dataset["piston_height"].values == pytest.approx(height, rel=1e-7)
    loss = run.dataset["piston_loss"].values
    assert (np.diff(loss) >= 0.0).all()
    assert run.settings()["ledger_residual"] < 1e-6


@pytest.mark.parametrize(("friction", "moves"), [(19.0, True), (20.0, False)])
@quick_in_plain_python
def test_piston_with_friction_above_its_weight_stays_exactly_at_rest(friction: float, moves: bool) -> None:
    """The weight is 19.6 N. With less friction the piston falls at constant acceleration."""
    run = run_empty_cell(
        {"kind": "free", "name": "fall", "duration": 0.1}, **BARE, **{"piston.friction": friction}
    )
    time, height = (run.dataset[name].values for name in ("time", "piston_height"))
    if moves:
        assert height == pytest.approx(0.12 - 0.5 * (9.8 - friction / 2.0) * time**2, rel=1e-6)
    else:
        assert (height == 0.12).all()
    assert run.settings()["ledger_residual"] < 1e-6


@pytest.mark.parametrize("friction", [5.0, 25.0])
@quick_in_plain_python
def test_piston_thrown_upwards_falls_back_or_sticks(friction: float) -> None:
    """It falls back if its weight exceeds the friction, and sticks at the top otherwise."""
    push, weight, mass, until = 80.0, 19.6, 2.0, 0.05
    run = run_empty_cell(
        {"kind": "push", "name": "push", "mean": push, "duration": until},
        {"kind": "free", "name": "flight", "duration": 0.2},
        **BARE,
        **{"piston.friction": friction},
    )
    rise = (push - weight - friction) / mass
    speed, brake = rise * until, (weight + friction) / mass
    top = 0.12 + 0.5 * rise * until**2 + 0.5 * speed**2 / brake
    remaining = 0.2 - speed / brake
    fallen = 0.5 * max(weight - friction, 0.0) / mass * remaining**2 if remaining > 0.0 else 0.0
    height, loss = (run.dataset[name].values for name in ("piston_height", "piston_loss"))
    assert remaining > 0.0
    assert height[-1] == pytest.approx(top - fallen, abs=1e-5)
    assert (np.diff(loss) >= 0.0).all()
    assert loss[-1] == pytest.approx(friction * (top - 0.12 + fallen), rel=1e-3)
    if friction > weight:
        assert run.dataset["piston_velocity"].values[-1] == 0.0


def test_free_grain_in_a_shaken_cell_follows_the_exact_solution_in_the_frame_of_the_cell() -> None:
    scene = load_scene("single-particle").replace(
        **{
            "effects.gravity.acceleration": 0.0,
            "effects.walls": None,
            "effects.shaking": {"amplitude": 0.01, "frequency": 20.0, "angle": 0.5},
            "effects.drag": {"coefficient": 0.0},
            "protocol": [{"kind": "hold", "name": "shake", "duration": 0.1}],
            "output.scalars": 1e-3,
            "output.frames": 1e-3,
        }
    )
    run = simulate(scene, dt=1e-5, progress=False)
    time = run.dataset["frame_time"].values
    position = run.dataset["position"].values[:, 0]
    w = 40.0 * math.pi
    displacement = 0.01 * (w * time - np.sin(w * time))
    assert position[:, 0] - position[0, 0] == pytest.approx(displacement * math.cos(0.5), abs=1e-7)
    assert position[:, 1] - position[0, 1] == pytest.approx(displacement * math.sin(0.5), abs=1e-7)
    assert run.settings()["ledger_residual"] < 1e-5


def test_lifting_the_piston_may_be_the_first_stage(small_damper: Scene) -> None:
    run = run_protocol(
        small_damper,
        {"kind": "lift", "name": "lift", "by": "0.3 D"},
        {"kind": "free", "name": "fall", "duration": 0.02},
        **{"output.record": None},
    )
    assert run.dataset["piston_height"].values[0] == pytest.approx(6.3 * D)
    assert run.settings()["ledger_residual"] < 1e-3


def test_error_for_lowering_the_piston_into_the_bed_names_the_stage(small_damper: Scene) -> None:
    with pytest.raises(OutsideError, match=r"stage 'lift' moves the piston into the bed"):
        run_protocol(small_damper, {"kind": "lift", "name": "lift", "by": "-4 D"}, **{"output.record": None})


def test_time_at_which_a_bed_counts_as_at_rest_does_not_depend_on_the_record_interval(
    small_damper: Scene,
) -> None:
    """The criterion is tested equally often for any interval."""
    soon = small_damper.replace(**{"effects.drag.coefficient": 2.0})
    fall = {"kind": "free", "name": "drop", "until": "rest"}
    ends = [
        run_protocol(
            soon, fall, **{"output.record": None, "output.scalars": cadence, "output.frames": cadence}
        )
        .stage("drop")
        .end
        for cadence in (5e-3, 0.5)
    ]
    assert ends[1] == pytest.approx(ends[0], abs=0.02)


def test_automatic_time_step_is_shortened_before_an_impact_between_records(small_damper: Scene) -> None:
    fall = {"kind": "free", "name": "drop", "duration": 0.4}  # the impact is at 0.2 s
    changes = {
        "output.record": None,
        "output.scalars": 1.0,
        "output.frames": 1.0,
        "piston.height": "40 D",
        "effects.drag.coefficient": 0.0,
    }
    run = run_protocol(small_damper, fall, **changes)
    assert run.settings()["ledger_residual"] < 1e-3


def test_run_can_be_resumed_only_to_a_later_end(small_damper: Scene, tmp_path: object) -> None:
    free = {"kind": "free", "name": "fall", "duration": 0.02}
    scene = small_damper.replace(**{"protocol": [free], "output.record": None})

    def run(t_end: float | None, path: str) -> Trajectory:
        return simulate(scene, t_end=t_end, out=f"{tmp_path}/{path}", resume=True, progress=False)

    run(0.015, "longer")
    later = run(0.03, "longer")
    assert later.complete
    assert later.stages[-1].end == pytest.approx(0.03)
    integer = simulate(scene, t_end=0.03, progress=False)
    assert later.dataset["piston_height"].values[-1] == integer.dataset["piston_height"].values[-1]
    with pytest.raises(StoreError, match=r"has already reached 0\.03 s"):
        run(0.01, "longer")
    with pytest.raises(StoreError, match="after the end of stage 'fall'"):
        run(None, "longer")
    ended = run(None, "ended")
    assert run(None, "ended").dataset.equals(ended.dataset)
    with pytest.raises(StoreError, match=r"ended at 0\.02 s"):
        run(0.05, "ended")


TAPS = """
import math
from granular import quantity, stage

@stage
class FileTap:
    depth: float = quantity("m", above=0.0)

    @staticmethod
    def height(p, time, start):
        return start - p.depth * math.sin(math.pi * time / p.duration) ** 2
"""


@stage
class Tap:
    """Custom stage in which the piston moves smoothly down and up again."""

    depth: float = quantity("m", above=0.0)

    @staticmethod
    def height(p, time, start):  # type: ignore[no-untyped-def]  # as users write it
        return start - p.depth * math.sin(math.pi * time / p.duration) ** 2


def bed(*protocol: dict[str, object]) -> Scene:
    changes = {"grains.count": 20, "cell.width": "10 D", "protocol": list(protocol), "output.record": None}
    return load_scene("damper").replace(**changes)


def test_scene_with_a_custom_stage_is_restored_from_its_plain_data_and_has_a_digest_of_its_code(
    tmp_path: Path,
) -> None:
    scene = bed({"kind": "tap", "name": "tap", "depth": 1e-3, "duration": 0.1})
    scene.save(tmp_path / "tap.toml")
    assert load_scene(tmp_path / "tap.toml") == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert custom_code_digests(scene) == [Tap.definition.digest]


def test_custom_stage_is_pickled_with_the_source_text_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "taps.py").write_text(TAPS)
    import_user_code_and_collect_measures([tmp_path / "taps.py"])
    scene = bed({"kind": "file_tap", "name": "tap", "depth": 1e-3, "duration": 0.1})
    assert b"math.sin(math.pi" in pickle.dumps(scene)  # by the file's text
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_invalid_classes_for_custom_stages_are_errors() -> None:
    with pytest.raises(InputError, match="has no function that can act; add a static method 'height' or"):
        stage(type("Idle", (), {}))
    with pytest.raises(InputError, match="'hold' is built in"):
        stage(type("Hold", (), {"height": staticmethod(lambda p, time, start: start)}))
    with pytest.raises(SceneError, match="depth: must be given"):
        bed({"kind": "tap", "name": "tap", "duration": 0.1})


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda p, time, start: start + 1e-3, "starts at .* choose a function that equals"),
        (
            lambda p, time, start: start + 1e-3 * (time > 0.031),
            "changes too fast for a spline, or is not smooth",
        ),
        (lambda p, time, start: math.sqrt(-time - 1.0), "height fails 0 s after .* start: ValueError"),
    ],
)
def test_custom_stage_with_an_invalid_height_function_is_refused_before_the_run(
    function: object, words: str
) -> None:
    stage(type("Faulty", (), {"height": staticmethod(function)}))
    scene = bed({"kind": "faulty", "name": "one", "duration": 0.1})
    with pytest.raises(InputError, match=f"stage 'one', checked before the run: .*{words}"):
        simulate(scene, dt=1e-4, progress=False)


FREE = {"kind": "free", "name": "first", "duration": 0.01}
HELD = {"kind": "hold", "name": "first", "duration": 0.01}


@pytest.mark.parametrize(
    ("before", "function", "words"),
    [
        (HELD, lambda p, time, start: p.nothing, "height fails 0 s after .*AttributeError"),
        (FREE, lambda p, time, start: p.nothing, "height fails 0 s after .*AttributeError"),
        (HELD, lambda p, time, start: start + math.sqrt(0.05 - time), "fails 0.05.* s after .*ValueError"),
        (FREE, lambda p, time, start: math.inf, "height: is infinite or not a number at the stage's start"),
        (HELD, lambda p, time, start: 0.1, "starts at 0.1 m, but the piston is at 0.12 m"),
    ],
)
def test_functions_of_later_custom_stages_are_also_checked_before_the_run(
    before: dict[str, object], function: object, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage(type("Faulty", (), {"height": staticmethod(function)}))
    monkeypatch.setattr("granular.run.simulation.ProtocolRunner", None)  # no run is started
    with pytest.raises(InputError, match=f"stage 'second', checked before the run: .*{words}"):
        simulate(bed(before, {"kind": "faulty", "name": "second", "duration": 0.1}), progress=False)


def test_custom_stage_after_a_free_stage_is_checked_before_the_run_except_for_its_initial_height() -> None:
    """The piston height at the end of the free stage is known only during the run."""
    stage(type("Timed", (), {"height": staticmethod(lambda p, time, start: 0.05 + 0.0 * time)}))
    stage(type("Pushed", (), {"force": staticmethod(lambda p, time: math.sqrt(0.05 - time))}))
    later = {"kind": "timed", "name": "second", "duration": 0.1}
    scales = Scales.from_grains(bed(HELD).grains)
    check_spline_stages(bed(FREE, later).protocol, 0.12, scales)
    moved = {"kind": "move", "name": "m", "to": 0.05, "speed": 0.1}
    check_spline_stages(bed(HELD, moved, later).protocol, 0.12, scales)
    for first in (FREE, HELD):
        scene = bed(first, {"kind": "pushed", "name": "second", "duration": 0.1})
        with pytest.raises(
            InputError, match=r"stage 'second', checked before the run: .*force fails 0\.05.* s after"
        ):
            check_spline_stages(scene.protocol, 0.12, scales)


def test_error_of_a_custom_stage_during_the_run_names_stage_and_time() -> None:
    stage(type("Timed", (), {"height": staticmethod(lambda p, time, start: 0.05 + 0.0 * time)}))
    scene = bed(FREE, {"kind": "timed", "name": "second", "duration": 0.1})
    with pytest.raises(InputError, match=r"stage 'second', at t = 0\.01 s: height: starts at 0\.05 m"):
        simulate(scene, dt=1e-4, progress=False)


@pytest.mark.parametrize("frequency", [6.4, 12.8, 6.41, 3.2])
def test_sinusoidal_piston_path_given_by_a_formula_is_accurate_at_any_frequency(frequency: float) -> None:
    """Frequencies commensurate with 64 or 128 spline knots in 10 s are included, since they could hide
    an error.
    """
    path = {"kind": "path", "name": "sine", "height": "h0 + a*sin(2*pi*f*t)", "a": "1 mm", "duration": "10 s"}
    scene = bed(path | {"f": f"{frequency} Hz"})
    scales = Scales.from_grains(scene.grains)
    motion = scene.protocol[0].piston_motion(0.1, scales)
    time = np.linspace(0.0, 10.0, 20011)[1:-1]
    height = [driven_height_and_velocity(motion, t / scales.time)[0] * scales.length for t in time]
    np.testing.assert_allclose(height, 0.1 + 1e-3 * np.sin(2.0 * np.pi * frequency * time), atol=1e-12)
