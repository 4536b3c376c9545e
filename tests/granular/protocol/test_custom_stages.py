"""Stages of a user's own: the same motion as by a formula, in any process, and known by their code."""

import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, load_scene, quantity, simulate, stage
from granular.protocol.piston_motion import driven_height_and_velocity
from granular.protocol.stages import try_stages
from granular.run.simulation import custom_code_digests
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, SceneError
from granular.user_code import import_user_code

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
    """The piston goes down and up again, softly."""

    depth: float = quantity("m", above=0.0)

    @staticmethod
    def height(p, time, start):  # type: ignore[no-untyped-def]  # as users write it
        return start - p.depth * math.sin(math.pi * time / p.duration) ** 2


def bed(*protocol: dict[str, object]) -> Scene:
    changes = {"grains.count": 20, "cell.width": "10 D", "protocol": list(protocol), "output.record": None}
    return load_scene("damper").replace(**changes)


def test_a_scene_with_one_round_trips_and_is_known_by_its_code(tmp_path: Path) -> None:
    scene = bed({"kind": "tap", "name": "tap", "depth": 1e-3, "duration": 0.1})
    scene.save(tmp_path / "tap.toml")
    assert load_scene(tmp_path / "tap.toml") == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert custom_code_digests(scene) == [Tap.definition.digest]


def test_a_file_brings_one_to_other_processes(tmp_path: Path) -> None:
    (tmp_path / "taps.py").write_text(TAPS)
    import_user_code([tmp_path / "taps.py"])
    scene = bed({"kind": "file_tap", "name": "tap", "depth": 1e-3, "duration": 0.1})
    assert b"math.sin(math.pi" in pickle.dumps(scene)  # by the file's text
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_what_a_class_cannot_be() -> None:
    with pytest.raises(InputError, match="does nothing; give it a static method 'height' or 'force'"):
        stage(type("Idle", (), {}))
    with pytest.raises(InputError, match="'hold' is a built-in one"):
        stage(type("Hold", (), {"height": staticmethod(lambda p, time, start: start)}))
    with pytest.raises(SceneError, match="depth: must be given"):
        bed({"kind": "tap", "name": "tap", "duration": 0.1})


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda p, time, start: start + 1e-3, "begins at .* let it begin at the height"),
        (lambda p, time, start: start + 1e-3 * (time > 0.031), "changes too fast, or is not smooth"),
        (lambda p, time, start: math.sqrt(-time - 1.0), "height fails 0 s after .* start: ValueError"),
    ],
)
def test_functions_that_are_no_motion(function: object, words: str) -> None:
    stage(type("Faulty", (), {"height": staticmethod(function)}))
    scene = bed({"kind": "faulty", "name": "one", "duration": 0.1})
    with pytest.raises(InputError, match=f"stage 'one', tried before the run: .*{words}"):
        simulate(scene, dt=1e-4, progress=False)


FREE = {"kind": "free", "name": "first", "duration": 0.01}
HELD = {"kind": "hold", "name": "first", "duration": 0.01}


@pytest.mark.parametrize(
    ("before", "function", "words"),
    [
        (HELD, lambda p, time, start: p.nothing, "height fails 0 s after .*AttributeError"),
        (FREE, lambda p, time, start: p.nothing, "height fails 0 s after .*AttributeError"),
        (HELD, lambda p, time, start: start + math.sqrt(0.05 - time), "fails 0.05.* s after .*ValueError"),
        (FREE, lambda p, time, start: math.inf, "height: is not finite at the stage's start"),
        (HELD, lambda p, time, start: 0.1, "begins at 0.1 m and the piston stands at 0.12 m"),
    ],
)
def test_a_later_stage_is_tried_before_the_run(
    before: dict[str, object], function: object, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage(type("Faulty", (), {"height": staticmethod(function)}))
    monkeypatch.setattr("granular.run.simulation.ProtocolRunner", None)  # which no run comes to
    with pytest.raises(InputError, match=f"stage 'second', tried before the run: .*{words}"):
        simulate(bed(before, {"kind": "faulty", "name": "second", "duration": 0.1}), progress=False)


def test_stages_after_a_free_one_begin_where_it_ends() -> None:
    """A stage that depends on that height is not refused before the run."""
    stage(type("Timed", (), {"height": staticmethod(lambda p, time, start: 0.05 + 0.0 * time)}))
    stage(type("Pushed", (), {"force": staticmethod(lambda p, time: math.sqrt(0.05 - time))}))
    later = {"kind": "timed", "name": "second", "duration": 0.1}
    scales = Scales.from_grains(bed(HELD).grains)
    try_stages(bed(FREE, later).protocol, 0.12, scales)
    moved = {"kind": "move", "name": "m", "to": 0.05, "speed": 0.1}
    try_stages(bed(HELD, moved, later).protocol, 0.12, scales)
    for first in (FREE, HELD):
        scene = bed(first, {"kind": "pushed", "name": "second", "duration": 0.1})
        with pytest.raises(InputError, match=r"stage 'second', tried .*force fails 0\.05.* s after"):
            try_stages(scene.protocol, 0.12, scales)


def test_what_fails_in_its_turn_names_stage_and_time() -> None:
    stage(type("Timed", (), {"height": staticmethod(lambda p, time, start: 0.05 + 0.0 * time)}))
    scene = bed(FREE, {"kind": "timed", "name": "second", "duration": 0.1})
    with pytest.raises(InputError, match=r"stage 'second', at t = 0\.01 s: height: begins at 0\.05 m"):
        simulate(scene, dt=1e-4, progress=False)


@pytest.mark.parametrize("frequency", [6.4, 12.8, 6.41, 3.2])
def test_a_path_keeps_its_amplitude_at_any_frequency(frequency: float) -> None:
    """Also at those that fit the spacing of 64 or 128 knots in 10 s, where the spline looked right."""
    path = {"kind": "path", "name": "sine", "height": "h0 + a*sin(2*pi*f*t)", "a": "1 mm", "duration": "10 s"}
    scene = bed(path | {"f": f"{frequency} Hz"})
    scales = Scales.from_grains(scene.grains)
    motion = scene.protocol[0].motion(0.1, scales)
    time = np.linspace(0.0, 10.0, 20011)[1:-1]
    height = [driven_height_and_velocity(motion, t / scales.time)[0] * scales.length for t in time]
    np.testing.assert_allclose(height, 0.1 + 1e-3 * np.sin(2.0 * np.pi * frequency * time), atol=1e-12)
