"""The history of speed keeps every entry, and shows the newest against those before."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import history
from benchmarks.__main__ import main
from granular.commands.console import launch
from granular.shared.errors import InputError


def entry(ratio: float, **more: Any) -> dict[str, Any]:
    return {"commit": "abc", "changed": False, "date": "2026-01-01 00:00", **more, "ratios": {"sum": ratio}}


def test_entries_are_added_one_a_line(tmp_path: Path) -> None:
    path = tmp_path / "speed.jsonl"
    assert history.read(path) == []
    for k in range(3):
        assert len(history.add(path, entry(float(k)))) == k + 1
    assert path.read_text().count("\n") == 3
    assert history.read(path) == [entry(0.0), entry(1.0), entry(2.0)]


def test_table_compares_the_newest_with_the_median_before() -> None:
    many = [entry(9.0)] * 30 + [entry(2.0), entry(2.0), entry(4.0), entry(3.0, changed=True)]
    shown = history.history_table(many[-4:])
    assert list(shown.rows[-1][2:]) == ["1.50"]
    assert shown.rows[-2][1] == "abc+"
    assert len(history.history_table(many).rows) == 13
    assert len(history.history_table(many[:1]).rows) == 1


def test_a_kernel_that_is_new_has_nothing_to_be_compared_with() -> None:
    new = entry(1.0)
    new["ratios"] = {"step": 5.0}
    shown = history.history_table([entry(1.0), new])
    assert list(shown.header[2:]) == ["sum", "step"]
    assert list(shown.rows[-1][2:]) == ["", ""]


@pytest.mark.parametrize("line", ["nonsense", "[]", "{}", '{"ratios": {"sum": "fast"}}', "7"])
def test_a_line_that_is_none_is_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "speed.jsonl"
    path.write_text(json.dumps(entry(1.0)) + "\n" + line + "\n")
    with pytest.raises(InputError, match="line 2 is not an entry"):
        history.read(path)


def test_command_adds_an_entry_and_refuses_what_it_does_not_heed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(history, "measured", lambda: entry(0.5))
    path = tmp_path / "speed.jsonl"
    for _ in range(2):
        assert launch(main, ["--history", str(path)]) == 0
    assert len(history.read(path)) == 2
    assert "newest over the median before" in capsys.readouterr().out
    assert launch(main, ["--history", str(path), "--full"]) == 2
    assert launch(main, ["--history", str(tmp_path)]) == 2
    assert len(history.read(path)) == 2


@pytest.mark.long
def test_ratios_are_those_of_the_kernels() -> None:
    found = history.measured(rounds=2, jobs=["compression of 92 grains"])
    assert found["reference"]["seconds"] > 0.0
    wanted = {"direct sum", "step, drag", "fit, linear law", "compression of 92 grains, processor"}
    assert wanted <= set(found["ratios"])
    assert 0.0 < found["ratios"]["direct sum"] < 1.0
