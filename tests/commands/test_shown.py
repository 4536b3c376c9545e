"""Commands and options that are mentioned in pages, messages and `--help` exist."""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from granular.commands.console import Parser

from .shown import PAGES, PARSERS, ROOT, commands, parser_of, parsers


def test_commands_are_found_in_pages_and_help() -> None:
    assert len(commands()) > 60


@pytest.mark.parametrize("line", commands())
def test_commands_and_options_shown_in_the_pages_exist(line: str) -> None:
    words = shlex.split(line.partition(" > ")[0], comments=True)
    parser, rest = parser_of(words)
    if rest and rest[0] not in ("--help", "--version"):
        parser.parse_args(rest)


@pytest.mark.parametrize("parser", list(parsers()), ids=lambda parser: parser.prog)
def test_examples_in_help_are_commands_of_the_program(parser: Parser) -> None:
    """Each line from "examples:" to the next empty line is checked, except comments."""
    text = (parser.epilog or "").replace("\\\n", " ").partition("examples:\n")[2].partition("\n\n")[0]
    for line in text.splitlines():
        assert "%(prog)s" in line or line.strip().startswith("#"), line


OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
TOOLS = ("granular", "reduced_models", "validation")


def options() -> dict[str, set[str]]:
    """Return the options of each command."""
    parsers = (
        action.choices
        for tool in TOOLS
        for action in PARSERS[tool]._actions
        if isinstance(action.choices, dict)
    )
    return {
        name: {word for action in parser._actions for word in action.option_strings}
        for choices in parsers
        for name, parser in choices.items()
    }


OPTIONS = options()
RECORDS = ("look", "identify", "fit", "compare", "discover", "calibrate")
METHODS = tuple(name for name, words in OPTIONS.items() if {"--method", "--dt"} <= words)
WRITERS = ("observe", "render", "export")
SEEN_ON = {
    "granular/export": ("export",),
    "granular/methods": METHODS,
    "granular/observables": ("observe",),
    "granular/records": RECORDS,
    "granular/response": ("response",),
    "granular/scene": ("run", "show", "identify"),
    "granular/shared/files.py": WRITERS,
    "granular/studies/tolerances.py": ("tolerances",),
    "granular/studies": ("sweep",),
    "reduced_models/identification": ("identify",),
    "reduced_models/machines": ("response",),
    "reduced_models/records": RECORDS,
}
"""Commands to which texts of a folder refer, unless the text gives one."""


def texts(path: Path) -> Iterator[str]:
    """Yield the strings of a file that users read.

    Docstrings, examples, and strings that consist only of an option are excluded.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = ""  # a docstring
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
            other = any(mark in text for mark in ("%(prog)s", "``", "python -m", "{"))
            if not other and not OPTION.fullmatch(text):
                yield text


def commands_of(path: Path, text: str) -> list[tuple[str, ...]]:
    """Return groups of commands to which a text refers.

    In each group, at least one command must have an option that the text mentions.
    """
    name = path.relative_to(ROOT).as_posix()
    room = next((room for room in SEEN_ON if name.startswith(room)), None)
    return [(command,) for command in SEEN_ON[room]] if room else [commands_defined_in(path)]


def commands_defined_in(path: Path) -> tuple[str, ...]:
    """Return the commands defined in a file, or all commands if the file defines none."""
    if path.parent.name != "commands" or path.name == "console.py":
        return tuple(OPTIONS)
    found = re.findall(r"@command\(\s*\"([a-z-]+)\"", path.read_text(encoding="utf-8"))
    return tuple(found) or tuple(OPTIONS)


FILES = [
    path
    for tool in TOOLS
    for path in sorted((ROOT / tool).rglob("*.py"))
    if any(OPTION.search(text) for text in texts(path)) and path.name != "console_script.py"
]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_options_mentioned_in_messages_exist(path: Path) -> None:
    for text in texts(path):
        named = re.search(r"\b([a-z-]+) (--[a-z-]+)", text)
        groups = commands_of(path, text)
        if named and named[1] in OPTIONS:
            groups = [(named[1],)]
        for word in OPTION.findall(text):
            for group in groups:
                assert any(word in OPTIONS[name] for name in group), (text, word, group)


def test_messages_that_mention_options_are_found() -> None:
    named = {word for path in FILES for text in texts(path) for word in OPTION.findall(text)}
    assert {"--columns", "--between", "--release", "--import", "--force", "--drift"} <= named


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_options_mentioned_in_pages_exist(page: Path) -> None:
    """An option shown with a command must exist for that command; an option shown alone, for some command."""
    every = set().union(
        *OPTIONS.values(),
        {"--version"},
        *(
            word
            for parser in PARSERS.values()
            for action in parser._actions
            for word in [action.option_strings]
        ),
    )
    prose = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for code in re.findall(r"`([^`\n]+)`", prose):
        first = code.removeprefix("granular-damper ").split()[0] if code.split() else ""
        for word in OPTION.findall(code):
            known = OPTIONS.get(first, every if code.startswith("--") else None)
            assert known is None or word in known, (code, word)
