"""Command that is being carried out, for reports that name what made them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextvars import ContextVar

_COMMAND: ContextVar[str] = ContextVar("command", default="")


def set_command(program: str, arguments: Sequence[str]) -> None:
    """Keep the command line that is carried out from now on."""
    _COMMAND.set(shlex.join([*program.split(), *arguments]))


def current_command() -> str:
    """Return the command line that is being carried out; empty where Python calls the functions itself."""
    return _COMMAND.get()
