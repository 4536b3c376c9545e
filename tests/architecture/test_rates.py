"""Grammatical patterns that are hard to read are as rare as in comparable packages."""

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("granular", "reduced_models", "validation")
KINDS = ("docstrings", "pages", "errors", "strings", "tests")
MAX_WORDS = 30
LONG_SENTENCES = 0.05


class Pattern(NamedTuple):
    """Regular expression of a grammatical pattern, and its maximum rate per 1000 words."""

    expression: str
    limit: float


# Limits are twice the highest rate of diffrax, REBOUND, PySINDy, magpylib and freud in docstrings
# and pages (one and a half times for "where"), and 0.1 for words that none of them uses.
PATTERNS = {
    "what as a noun": Pattern(
        r"\bwhat(?:ever)? (?:is|was|are|were|has|have|moves|follows|it|a|the|they|no|reads|varies|does)\b",
        0.42,
    ),
    "that of": Pattern(r"\b(?:that which|those which|that of|those of|those that)\b", 0.18),
    "is no": Pattern(r"\b(?:is|are|was|be) no(?:ne)? \w+", 0.26),
    "where for if": Pattern(r"\bwhere(?:ver)?\b", 1.88),
    "stands for is": Pattern(r"\bstands?\b", 0.1),
    "greatest, least": Pattern(r"\b(?:greatest|least)\b(?! squares)", 0.68),
    "goes on, is told": Pattern(r"\b(?:goe?s? on|tells?|is told|are told|said)\b", 0.34),
    "swing": Pattern(r"\bsw(?:ings?|inging|ung)\b", 0.1),
    "level of rest": Pattern(r"\blevels? of rest\b", 0.1),
    "left over": Pattern(r"\b(?:left over|(?:left|leave|leaves|leaving) (?:\w+ )?out)\b", 0.1),
    "anew, alike, beside": Pattern(r"\b(?:anew|alike|beside|doubts?|hence|heeded|nought)\b", 0.16),
    "of its own": Pattern(r"\b(?:of (?:its|one's|their) own|one's own)\b", 0.1),
}


class Texts(NamedTuple):
    """Texts of a file: docstrings, error messages, and other strings of at least three words."""

    docstrings: list[str]
    errors: list[str]
    strings: list[str]


def _constants(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the string constants of a syntax tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node


def read_texts(source: str) -> Texts:
    """Return the texts of a Python file by kind."""
    tree = ast.parse(source)
    owners = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
    statements = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    in_errors = {
        id(text)
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and ast.unparse(call.func).endswith("Error")
        for text in _constants(call)
    }
    docstrings = [ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, owners)]
    errors = [str(text.value) for text in _constants(tree) if id(text) in in_errors]
    strings = [
        str(text.value)
        for text in _constants(tree)
        if id(text) not in in_errors | statements and len(str(text.value).split()) > 2
    ]
    return Texts(docstrings, errors, strings)


def names_as_words(source: str) -> list[str]:
    """Return the names of a file's functions and classes, split into words."""
    nodes = ast.walk(ast.parse(source))
    return [node.name.replace("_", " ") for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)]


def _sources(*folders: str) -> list[str]:
    """Return the text of every Python file in the given folders."""
    paths = chain.from_iterable(sorted((ROOT / folder).rglob("*.py")) for folder in folders)
    return [path.read_text(encoding="utf-8") for path in paths]


@cache
def texts_of_project() -> dict[str, list[str]]:
    """Return the texts of the project by kind."""
    code = [read_texts(source) for source in _sources(*PACKAGES)]
    tests = _sources("tests")
    pages = [
        path
        for path in sorted((ROOT / "docs").rglob("*.md"))
        if "reference" not in path.parts and "renamed" not in path.name
    ]
    return {
        "docstrings": [text for file in code for text in file.docstrings],
        "pages": [path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *pages]],
        "errors": [text for file in code for text in file.errors],
        "strings": [text for file in code for text in file.strings],
        "tests": [
            text for source in tests for text in read_texts(source).docstrings + names_as_words(source)
        ],
    }


def rate(pattern: str, texts: Iterable[str]) -> float:
    """Return how often a pattern occurs per 1000 words."""
    text = "\n".join(texts)
    return 1000 * len(re.findall(pattern, text, re.IGNORECASE)) / max(1, len(text.split()))


def split_sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page or docstring, without code, tables, headings and comments."""
    text = re.sub(r"```.*?```|<!--.*?-->|\$\$.*?\$\$", "\n\n", text, flags=re.DOTALL)
    text = re.sub(r"(?m)^\s*(\||#|>>>|\.\.\.|!\[).*$", "\n", text)
    text = re.sub(r"(?m)^.*\n\s*-{3,}\s*$", "\n", text)
    text = re.sub(r"(?m)^\s*\w[\w, *.]* : .*$", "\n", text)
    text = re.sub(r"(?m)^\s*(?:[-*+]|\d+\.) ", "\n", text)
    for paragraph in re.split(r"\n\s*\n", text):
        for sentence in re.split(r"(?<=[.!?])[)\"*]*\s+", paragraph):
            if sentence.strip():
                yield " ".join(sentence.split())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_grammatical_patterns_that_are_hard_to_read_are_rare(kind: str, pattern: str) -> None:
    expression, limit = PATTERNS[pattern]
    assert rate(expression, texts_of_project()[kind]) <= limit


@pytest.mark.parametrize("kind", KINDS)
def test_few_sentences_are_long(kind: str) -> None:
    sentences = [s for text in texts_of_project()[kind] for s in split_sentences(text)]
    too_long = [s for s in sentences if len(s.split()) > MAX_WORDS]
    assert len(sentences) > 100
    assert len(too_long) <= LONG_SENTENCES * len(sentences), "\n".join(too_long)


def test_texts_of_a_file_are_classified_as_docstrings_errors_or_other_strings() -> None:
    source = 'def f():\n    """Say it."""\n    x = "three words here"\n    raise ValueError(f"{x} is no y")\n'
    texts = read_texts(source)
    assert [text for text in texts.docstrings if text] == ["Say it."]
    assert texts.errors == [" is no y"]
    assert texts.strings == ["three words here"]
    assert rate(PATTERNS["is no"].expression, texts.errors) == pytest.approx(1000 / 3)


def test_texts_are_split_into_sentences() -> None:
    text = "# Head\n\nOne two. Three four:\n\n- five\n- six\n\n```\ncode here\n```\nx : float\n    Seven.\n"
    assert list(split_sentences(text)) == ["One two.", "Three four:", "five", "six", "Seven."]
