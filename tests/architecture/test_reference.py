"""The reference pages list only names and files that exist."""

import importlib
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "reference"
BLOCK = re.compile(r"^::: ([\w.]+)\n((?:[ ]+.*\n|\n(?=[ ]))*)", re.MULTILINE)


def _blocks() -> Iterator[tuple[str, list[str]]]:
    """Return the names after ``:::`` on the reference pages, each with its listed members."""
    for page in sorted(PAGES.rglob("*.md")):
        for name, options in BLOCK.findall(page.read_text() + "\n"):
            listed = re.search(r"members: \[([^\]]*)\]", options)
            yield name, re.findall(r"\w+", listed[1]) if listed else []


BLOCKS = list(_blocks())


def _find(name: str) -> object:
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            result: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            result = getattr(result, part)
        return result
    raise AssertionError(f"{name} is not there")


@pytest.mark.parametrize(("name", "members"), BLOCKS)
def test_every_member_listed_on_a_reference_page_exists(name: str, members: list[str]) -> None:
    owner = _find(name)
    fields = getattr(owner, "__annotations__", {})
    assert not [member for member in members if not hasattr(owner, member) and member not in fields]


def test_reference_pages_list_the_members_of_more_than_fifty_objects() -> None:
    assert sum(bool(members) for _, members in BLOCKS) > 50


def test_files_and_functions_that_the_documentation_lists_for_a_simulation_exist() -> None:
    page = (PAGES / "where-things-are.md").read_text()
    rows = re.findall(r"^\| .*? \| `([\w/]+\.py)`.*? \| `(\w+)`", page, re.MULTILINE)
    assert len(rows) > 15
    for path, name in rows:
        texts = [file.read_text() for file in (ROOT / path).parent.glob("*.py")]
        assert any(re.search(rf"^(def|class) {name}\b|^{name} =", text, re.MULTILINE) for text in texts), name


def test_every_path_on_the_pages_for_contributors_exists() -> None:
    path = re.compile(r"`((?:granular|reduced_models|validation|docs|tests|benchmarks)/[\w./-]*)`")
    for page in (PAGES / "where-things-are.md", ROOT / "CONTRIBUTING.md"):
        assert not [name for name in path.findall(page.read_text()) if not (ROOT / name).exists()]


def _load_script(path: str) -> ModuleType:
    script = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert script is not None
    assert script.loader is not None
    module = importlib.util.module_from_spec(script)
    script.loader.exec_module(module)
    return module


def test_each_cell_of_a_table_is_labelled_with_the_heading_of_its_column() -> None:
    label = _load_script("docs/hooks/tables.py").on_page_content
    head = '<thead><tr><th>a</th><th style="x"><code>b</code> "c" &lt;</th></tr></thead>'
    body = '<tbody>{}<td{}>1</td><td{} style="y">2</td></tr></tbody></table><p><td></p>'
    rows = ("<tr>", "", ""), ("<tr>", ' data-label="a"', ' data-label="b &quot;c&quot; &lt;"')
    plain, labelled = (f"<table>{head}{body.format(*row)}" for row in rows)
    assert label(plain) == labelled


def test_the_reference_page_that_lists_all_files_is_up_to_date() -> None:
    module = _load_script("docs/files.py")
    assert module.PAGE.read_text(encoding="utf-8") == module.page_of_files(), "run python docs/files.py"
