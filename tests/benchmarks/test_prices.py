"""The table of prices: measured for a small bed, read again by what promises accuracies from it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import costs as module
from benchmarks.costs import Priced, costs, priced_scenes, prices_text, rounded
from granular import Scene
from granular.run import work_precision as stored
from validation.report_tasks import Plain

NAMES = ("piston force", "energy")


@pytest.fixture(scope="module")
def priced(small_bed: Scene) -> Priced:
    settle = {"kind": "hold", "name": "settle", "duration": "0.02 s"}
    scene = small_bed.replace(protocol=[settle])
    return Priced(scene, NAMES, ("auto*8", "auto*4"), (), "auto/2", 2)


@pytest.fixture(scope="module")
def found(priced: Priced, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plain]:
    path = tmp_path_factory.mktemp("prices") / "table.toml"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "priced_scenes", lambda: (priced,))
        return path, costs(path, progress=False)


def test_what_is_written_is_what_promises_are_made_from(
    found: tuple[Path, Plain], priced: Priced, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, plain = found
    monkeypatch.setattr(stored, "TABLE", path)
    stored.load_work_precision_scenes.cache_clear()
    try:
        known = stored.most_similar_measured_scene(priced.scene, "piston force")
    finally:
        stored.load_work_precision_scenes.cache_clear()
    assert known is not None
    assert known.grains == 23
    assert known.date == plain["made"]["date"]
    assert [(rung.method, rung.dt) for rung in known.entries] == [
        ("stormer-verlet", "auto*8"),
        ("stormer-verlet", "auto*4"),
    ]
    coarse, fine = known.entries
    assert coarse.bounds["energy"] > fine.bounds["energy"] > 0.0
    assert coarse.fraction == pytest.approx(2.0 * fine.fraction)
    assert coarse.frequency == pytest.approx(2.0 * fine.frequency, rel=0.05)
    assert known.floors["piston force"] > 0.0
    text = prices_text(plain)
    assert "2 starts" in text
    assert "stormer-verlet auto*8" in text


def test_what_was_measured_is_taken_up_again(
    found: tuple[Path, Plain], priced: Priced, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, before = found
    monkeypatch.setattr(module, "priced_scenes", lambda: (priced,))
    monkeypatch.setattr(module, "_truth", pytest.fail)
    monkeypatch.setattr(module, "_rung", pytest.fail)
    assert costs(path, progress=False)["scenes"] == before["scenes"]


def test_scenes_of_the_table_are_of_their_kinds() -> None:
    scenes = priced_scenes()
    assert {stored.damping_kind(one.scene) for one in scenes} == {"friction", "drag"}
    assert len({str(one.key) for one in scenes}) == len(scenes)


@given(st.floats(1e-30, 1e30))
def test_errors_are_rounded_upwards(value: float) -> None:
    assert value * (1.0 - 1e-12) <= rounded(value) <= 1.0101 * value
