"""Every command that guide, README and `--help` show is one, as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import granular.__main__
import reduced_models.__main__
import validation.__main__
from granular.shared.console import Parser

ROOT = Path(__file__).parents[2]
PARSERS: dict[str, Parser] = {
    "granular": granular.__main__.parser(),
    "reduced_models": reduced_models.__main__.parser(),
    "validation": validation.__main__.parser(),
}


def of_pages() -> Iterator[str]:
    """Of the blocks of commands in README and guide."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for block in re.findall(r"```sh\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
            yield from textwrap.dedent(block).replace("\\\n", " ").splitlines()


def of_help() -> Iterator[str]:
    """Of the examples that `--help` ends with, the parts that a command has among them."""
    for parser in PARSERS.values():
        yield from examples(parser)
        (commands,) = (
            one.choices for one in parser._actions if isinstance(one.choices, dict)
        )  # fmt: skip
        for command in commands.values():
            yield from examples(command)


def examples(parser: Parser) -> Iterator[str]:
    """Lines of a parser's epilog that start with its own name."""
    text = (parser.epilog or "").replace("%(prog)s", parser.prog).replace("\\\n", " ")
    for line in text.splitlines():
        if line.strip().startswith(parser.prog):
            yield line.strip()


def of_toolkit() -> list[str]:
    """All commands of the toolkit, each once."""
    parts = (part.strip() for line in (*of_pages(), *of_help()) for part in line.split("&&"))
    ours = re.compile(r"python -m (granular|reduced_models|validation)\b")
    return list(dict.fromkeys(filter(ours.match, parts)))


COMMANDS = of_toolkit()


def test_there_are_commands() -> None:
    assert len(COMMANDS) > 60


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_that_is_shown_is_one(line: str) -> None:
    """Names and options are those of the program."""
    words = shlex.split(line, comments=True)
    PARSERS[words[2]].parse_args(words[3:])


QUICK = ("look", "simulate", "export-model", "scenes", "show")
"""Commands that take seconds; those that fit, simulate a bed or compare have tests of their own."""
FILES = ("lab.csv", "model.json", "out/model.json", "bed", "damper")
"""What they may be given here."""


def runs_here(line: str) -> bool:
    """Whether a command is quick, and all that it needs is there."""
    words = shlex.split(line, comments=True)[3:]
    given = words[1:2] == [] or words[1] in FILES
    return words[0] in QUICK and given and "--decimal" not in words


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands name: a record, and a model in two places."""
    here = tmp_path_factory.mktemp("lab")
    time = np.linspace(0.0, 6.0, 1500)
    height = 0.059 + 0.0012 * np.exp(-0.8 * time) * np.cos(21.8 * time)
    rows = [f"{t!r},{z!r}" for t, z in zip(time.tolist(), height.tolist(), strict=True)]
    (here / "lab.csv").write_text("\n".join(["t,dist", *rows, ""]))
    (here / "out").mkdir()
    saved = (ROOT / "tests" / "data" / "former" / "model.json").read_bytes()
    for name in ("model.json", "out/model.json"):
        (here / name).write_bytes(saved)
    return here


@pytest.mark.long
@pytest.mark.parametrize("line", list(filter(runs_here, COMMANDS)))
def test_quick_ones_run_as_they_stand(line: str, folder: Path) -> None:
    words = shlex.split(line, comments=True)
    done = subprocess.run(
        [sys.executable, *words[1:]], check=False, capture_output=True, text=True, cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
