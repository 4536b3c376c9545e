"""Every command that guide, README and `--help` show is one, unchanged there."""

from __future__ import annotations

import shlex

import pytest

from .shown import commands, parser_of


def test_there_are_commands() -> None:
    assert len(commands()) > 60


@pytest.mark.parametrize("line", commands())
def test_a_command_that_is_shown_is_one(line: str) -> None:
    """Names and options are those of the program."""
    words = shlex.split(line.partition(" > ")[0], comments=True)
    parser, rest = parser_of(words)
    if rest and rest[0] not in ("--help", "--version"):
        parser.parse_args(rest)
