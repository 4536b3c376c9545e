"""Progress: a bar where somebody looks, lines in a log."""

from __future__ import annotations

import sys

import pytest

from granular.shared.progress_bars import progress_bar


def test_a_log_has_a_line_at_the_start_and_one_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    for _ in progress_bar(iterable=range(500), desc="cases", bar_format="{desc} {bar:20} {n_fmt}"):
        pass
    said = capsys.readouterr().err
    assert said == "cases 0\ncases 500\n"


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
