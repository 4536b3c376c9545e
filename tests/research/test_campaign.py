"""Common parts of campaigns: blocks of pages, cached rows, and a command that edits pages only on request."""

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from granular.commands.console import run_command_and_return_exit_code
from granular.shared.errors import InputError
from granular.shared.files import ResultCache
from research import campaign
from research.campaign import (
    Campaign,
    PageBlock,
    make_or_read_cached_rows,
    markdown_table,
    read_results,
    results_file_of_campaign,
    round_floats_in_plain_data,
    write_results,
)

ROOT = Path(__file__).parents[2]
NAMES = ("disorder", "discovery", "melting", "published", "recovery")
INSTALLED = ("granular", "reduced_models", "validation")
Plain = dict[str, Any]


def blocks(found: Plain) -> Mapping[str, PageBlock]:
    return {"sum": PageBlock("page.md", f"{sum(found['rows'])} in all")}


def made(**changes: Any) -> Campaign[Plain]:
    settings: Plain = {
        "name": "made",
        "purpose": "Nothing.",
        "quick": "a little",
        "full": "all",
        "run": lambda options: {"rows": [1, 2] if options.quick else [1, 2, 3]},
        "from_plain": dict,
        "empty": {"rows": []},
        "text": lambda found: f"{found['rows']}",
        "summary": dict,
        "blocks": blocks,
    }
    return Campaign(**(settings | changes))


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with committed results and a page."""
    monkeypatch.setattr(campaign, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "research" / "made").mkdir(parents=True)
    write_results({"rows": [4, 5]}, results_file_of_campaign("made"))
    begin, end = made().begin_and_end_marks("sum")
    (tmp_path / "page.md").write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    return tmp_path


def test_blocks_of_a_page_are_written_only_between_their_marks(checkout: Path) -> None:
    one = made()
    assert one.outdated_blocks(one.read_committed_results(), checkout) == ["page.md: sum"]
    assert one.write_pages(one.read_committed_results(), checkout) == [checkout / "page.md"]
    begin, end = one.begin_and_end_marks("sum")
    assert (checkout / "page.md").read_text() == f"before\n{begin}\n9 in all\n{end}\nafter\n"
    assert one.outdated_blocks(one.read_committed_results(), checkout) == []
    assert one.outdated_blocks({"rows": [1]}, checkout) == ["page.md: sum"]


@pytest.mark.parametrize(
    ("words", "said"), [((), "[4, 5]"), (("--quick",), "[1, 2]"), (("--full",), "[1, 2, 3]")]
)
def test_command_of_a_campaign_runs_only_the_selected_cases(
    words: tuple[str, ...], said: str, checkout: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (checkout / "page.md").read_text()
    assert run_command_and_return_exit_code(made().main, list(words)) == 0
    assert capsys.readouterr().out.startswith(f"{said}\n")
    assert (checkout / "page.md").read_text() == before


def test_results_of_campaigns_made_with_outdated_code_are_listed(
    checkout: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_and_return_exit_code(made(stale=lambda _: ["row 4"]).main, ["--check", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"stale": ["row 4"], "pages": ["page.md: sum"]}


def test_rows_of_campaign_results_are_cached_and_reused(tmp_path: Path) -> None:
    def stops(case: int) -> Plain:
        if case == 2:
            raise KeyboardInterrupt
        return {"case": case}

    cache = ResultCache(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        make_or_read_cached_rows([0, 1, 2], str, stops, cache, label="rows", progress=False)
    rows = make_or_read_cached_rows(
        [0, 1, 2], str, lambda case: {"new": case}, cache, label="r", progress=False
    )
    assert rows == [{"case": 0}, {"case": 1}, {"new": 2}]


def test_campaign_results_are_read_exactly_as_written(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    plain = {"made": {"command": "c"}, "rows": [{"x": 1.5}, {"x": None}]}
    assert read_results(path, dict, {}) == {}
    write_results(plain, path)
    assert read_results(path, dict, {}) == plain
    assert path.read_text().count("\n") == 3  # one line per row
    path.write_text("[1,")
    with pytest.raises(InputError, match="holds no results"):
        read_results(path, dict, {})


def test_numbers_are_rounded_and_tables_are_formatted_for_pages() -> None:
    assert round_floats_in_plain_data({"a": [1 / 3, 2, ("b", 2 / 3)]}, 2) == {"a": [0.33, 2, ["b", 0.67]]}
    assert markdown_table(("a", "b"), [("1", "2")]) == "| a | b |\n|---|---|\n| 1 | 2 |"


@pytest.mark.parametrize("name", NAMES)
def test_every_campaign_has_committed_results(name: str) -> None:
    one: Campaign[Any] = importlib.import_module(f"research.{name}.__main__").CAMPAIGN
    assert one.name == name
    assert one.read_committed_results() != one.empty
    if name != "disorder":  # its bootstrap takes seconds
        assert one.blocks(one.read_committed_results())


def test_installed_packages_contain_no_campaigns_or_their_results() -> None:
    found = [path.name for one in INSTALLED for path in (ROOT / one).rglob("results.json")]
    assert found == []
    for one in INSTALLED:
        commands = set(importlib.import_module(f"{one}.__main__").parser().commands)
        assert not commands & {*NAMES, "benchmark", "prices", "silverbox"}
