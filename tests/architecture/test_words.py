"""Names and docstrings use terms that are standard in the field."""

import ast
import inspect
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("granular", "reduced_models", "validation")
OPENINGS = {"What", "Whether", "How", "Of", "Where", "Which", "Who", "When"}
OPENINGS |= {"Before", "Behind", "Over", "Up"}

PRIVATE = """
one ones each found place places span spans room rooms way ways told swung begun sharpened joined
thinned gathered holdout held_out whole share shares prices rung rungs glance shelf deed kept stored
course departed departure kick_all held_back at_home with_walk
"""
"""Former words for an item, an index, a duration, a buffer, a displacement, a fraction."""

KEYS = {("apparatus.py", "share")}
"""Keys of scenes, by which cached runs and results are identified."""

PRIVATE_PREFIXES = ("own_", "room_")


@cache
def trees() -> list[tuple[Path, ast.Module]]:
    """Return the path and syntax tree of every file of the packages."""
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return [(path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the names defined in a file, with their line numbers."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno


def is_private(name: str) -> bool:
    """Return True for a word that has a meaning only within this project."""
    bare = name.strip("_").lower()
    return bare in PRIVATE.split() or bare.startswith(PRIVATE_PREFIXES) or bare.endswith("_room")


def test_names_in_the_code_contain_no_words_with_a_meaning_only_within_this_project() -> None:
    assert is_private("_found")
    assert not is_private("found_defects")
    wrong = [f"{path}" for path, _ in trees() if is_private(path.stem)]
    wrong += [
        f"{path}:{line}: {name}"
        for path, tree in trees()
        for name, line in names(tree)
        if is_private(name) and (path.name, name) not in KEYS
    ]
    assert not wrong, "\n".join(wrong)


def docstrings(tree: ast.AST) -> Iterator[str]:
    """Yield the docstrings of a file, its classes and its functions, and the strings after assignments."""
    owners = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
    for node in ast.walk(tree):
        if not isinstance(node, owners):
            continue
        yield ast.get_docstring(node) or ""
        for before, after in pairwise(node.body):
            text = after.value if isinstance(after, ast.Expr) else None
            if isinstance(before, ast.Assign | ast.AnnAssign) and isinstance(text, ast.Constant):
                yield inspect.cleandoc(str(text.value))


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_begin_with_an_imperative_or_a_noun(package: str) -> None:
    openings = [
        f"{path}: {text.splitlines()[0]}"
        for path, tree in trees()
        if path.parts[0] == package
        for text in docstrings(tree)
        if text and text.split()[0].strip(",.:") in OPENINGS
    ]
    assert not openings, "\n".join(openings)


def test_the_check_of_docstrings_includes_strings_after_assignments() -> None:
    tree = ast.parse('limit = 3\n"""Of a file."""\nclass A:\n    x: int\n    """How many."""\n')
    assert set(docstrings(tree)) == {"", "Of a file.", "How many."}
