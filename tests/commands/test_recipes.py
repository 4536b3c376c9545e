"""Every recipe of the guide is a complete script, which runs alone and prints the output shown below it."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from reduced_models.records.example_records import write_example_records

from .outputs import assert_agrees, shortened
from .shown import ROOT

PAGE = ROOT / "docs" / "guide" / "recipes.md"
RECIPE = re.compile(
    r"^## (?P<title>.+?)\n.*?```python\n(?P<code>.*?)```\n\n```text\n(?P<shown>.*?)```", re.M | re.S
)
SLOW = re.compile(r"report|scene|force of my own|run")
"""Titles of recipes that simulate, or write reports."""
RECIPES = [
    pytest.param(
        one["code"], one["shown"], id=one["title"], marks=[pytest.mark.long] * bool(SLOW.search(one["title"]))
    )
    for one in RECIPE.finditer(PAGE.read_text(encoding="utf-8"))
]


def test_the_guide_has_ten_recipes_of_5_to_15_lines() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert len(RECIPES) == page.count("```python") == page.count("\n## ") == 10
    for one in RECIPE.finditer(page):
        assert 5 <= len([line for line in one["code"].splitlines() if line]) <= 15, one["title"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the example records."""
    folder = tmp_path_factory.mktemp("work")
    write_example_records(folder / "lab")
    return folder


@pytest.mark.filterwarnings("ignore::granular.shared.errors.CautionWarning")
@pytest.mark.parametrize(("code", "shown"), RECIPES)
def test_each_recipe_of_the_guide_runs_separately_and_prints_the_output_shown(
    code: str, shown: str, lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    if ".fmu" in code and shutil.which("cc") is None:
        pytest.skip("no C compiler")
    (tmp_path / "lab").symlink_to(lab / "lab", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, PAGE.name, "exec"), {"__name__": "__main__"})
    assert_agrees(shortened(capsys.readouterr().out), shown)
