"""Every command that guide, README and `--help` show is one, unchanged there."""

import shlex

import pytest

from granular.commands.console import Parser

from .shown import commands, parser_of, parsers


def test_there_are_commands() -> None:
    assert len(commands()) > 60


@pytest.mark.parametrize("line", commands())
def test_a_command_that_is_shown_is_one(line: str) -> None:
    """Names and options are those of the program."""
    words = shlex.split(line.partition(" > ")[0], comments=True)
    parser, rest = parser_of(words)
    if rest and rest[0] not in ("--help", "--version"):
        parser.parse_args(rest)


@pytest.mark.parametrize("parser", list(parsers()), ids=lambda parser: parser.prog)
def test_examples_of_help_are_commands(parser: Parser) -> None:
    """From the line "examples:" to the next empty one, comments aside, the program is called."""
    text = (parser.epilog or "").replace("\\\n", " ").partition("examples:\n")[2].partition("\n\n")[0]
    for line in text.splitlines():
        assert "%(prog)s" in line or line.strip().startswith("#"), line
