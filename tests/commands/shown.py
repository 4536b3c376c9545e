"""Find the commands and files shown in guide, README and `--help`."""

import importlib
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path

from granular.commands.console import Parser
from validation import console_script

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
CAMPAIGNS = sorted(path.parent.name for path in (ROOT / "research").glob("*/__main__.py"))
PROG = "granular-damper"
PARSERS: dict[str, Parser] = (
    {
        name: importlib.import_module(f"{name}.__main__").PROGRAM.parser(prog)
        for name, prog in (("granular", PROG), ("reduced_models", PROG), ("validation", f"{PROG} validate"))
    }
    | {
        name: importlib.import_module(f"{name}.__main__").parser()
        for name in ("benchmarks", *(f"research.{one}" for one in CAMPAIGNS))
    }
    | {PROG: console_script.OWN.parser()}
)
"""Parsers of the packages, as called by the toolkit's command, and of programs in a checkout."""


def commands() -> list[str]:
    """Return each shown command once, in the order of the pages."""
    parts = (part.strip() for line in (*of_pages(), *of_help()) for part in line.split("&&"))
    ours = re.compile(rf"{PROG}\b|python -m (benchmarks|research\.\w+)\b")
    return list(dict.fromkeys(filter(ours.match, parts)))


def of_pages() -> Iterator[str]:
    """Return the commands in the blocks of README and guide."""
    for block in blocks("sh"):
        yield from block.replace("\\\n", " ").splitlines()


def of_help() -> Iterator[str]:
    """Return the commands in the examples of `--help`, including subcommands."""
    for parser in parsers():
        yield from examples(parser)


def parsers() -> Iterator[Parser]:
    """Return all parsers, including those for subcommands."""
    for parser in PARSERS.values():
        yield parser
        for known in (one.choices for one in parser._actions if isinstance(one.choices, dict)):
            yield from known.values()


def examples(parser: Parser) -> Iterator[str]:
    """Return the lines of a parser's epilog that start with the program's name."""
    text = (parser.epilog or "").replace("%(prog)s", parser.prog).replace("\\\n", " ")
    for line in text.splitlines():
        if line.strip().startswith(parser.prog):
            yield line.strip()


def parser_of(words: list[str]) -> tuple[Parser, list[str]]:
    """Return the parser of a shown command line, and the arguments for it."""
    if words[0] != PROG:
        return PARSERS[words[2]], words[3:]
    if words[1:2] == ["validate"]:
        named = words[2:3] and words[2] in PARSERS["validation"].commands
        return PARSERS["validation"], words[2:] if named else ["report", *words[2:]]
    packages = ("granular", "reduced_models", "validation")
    home = next((name for name in packages if words[1] in PARSERS[name].commands), PROG)
    return PARSERS[home], words[1:]


def files() -> dict[str, str]:
    """Return the content of each file shown in the pages.

    The first line of a block names its file, and blocks of the same file are joined.
    """
    found: dict[str, str] = {}
    for block in (*blocks("python"), *blocks("toml")):
        if named := re.match(r"# ([\w-]+\.(?:py|toml))\n", block):
            found[named[1]] = found.get(named[1], "") + block
    return found


def blocks(language: str, pages: Iterable[Path] = PAGES) -> Iterator[str]:
    """Return the code blocks of README and guide in the given language."""
    for path in pages:
        text = path.read_text(encoding="utf-8")
        for block in re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL):
            yield textwrap.dedent(block)
