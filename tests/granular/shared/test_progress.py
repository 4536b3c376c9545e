"""Progress: a bar where somebody looks, lines in a log."""

import sys

import pytest

from granular.shared.progress_bars import progress_bar, stage_reporter


def test_a_log_has_a_line_at_the_start_and_one_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    for _ in progress_bar(iterable=range(500), desc="cases", bar_format="{desc} {bar:20} {n_fmt}"):
        pass
    said = capsys.readouterr().err
    assert said == "cases 0\ncases 500\n"


def test_a_log_has_no_line_for_every_word(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    with progress_bar(desc="cases", total=100) as bar:
        for k in range(100):
            bar.set_postfix_str(f"at {k}")
            bar.set_description_str(f"cases {k}")
            bar.update()
    assert capsys.readouterr().err.splitlines() == [
        "cases: 0 of 100 [00:00]",
        "cases 99: 100 of 100, at 99 [00:00]",
    ]


def test_a_log_has_a_line_a_minute(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    monkeypatch.setattr("granular.shared.progress_bars.time.monotonic", lambda: clock[0])
    with stage_reporter("search", wanted=True) as now:
        for k in range(200):
            clock[0] = float(k)
            now(f"at {k}")
    shown = [line.partition(" [")[0] for line in capsys.readouterr().err.splitlines()]
    assert shown == ["search", "search: at 60", "search: at 120", "search: at 180", "search: at 199"]


def test_a_terminal_has_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for _ in progress_bar(iterable=range(5), desc="cases", ascii=True):
        pass
    said = capsys.readouterr().err
    assert "\r" in said
    assert "cases: 100%|###" in said


def test_nothing_is_said_where_it_is_not_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in progress_bar(iterable=range(5), desc="cases", wanted=False):
        pass
    assert capsys.readouterr().err == ""
