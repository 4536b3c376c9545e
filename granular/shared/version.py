"""Versions of the toolkit and its libraries, and the present command line."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextvars import ContextVar

__version__ = "0.1.0"


def toolkit_and_library_versions(more: Sequence[str] = ()) -> dict[str, str]:
    """Return the versions of the toolkit and its numerical libraries, and the type of machine, by name."""
    import importlib.metadata
    from platform import machine, python_version

    result = {"python": python_version(), "machine": machine(), "granular-damper": __version__}
    for name in ("numpy", "numba", *more):  # numba may be missing without simulations
        try:
            result[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return result


_COMMAND: ContextVar[str] = ContextVar("command", default="")


def store_command_line(program: str, arguments: Sequence[str]) -> None:
    """Store the present command line."""
    _COMMAND.set(shlex.join([*program.split(), *arguments]))


def current_command_line() -> str:
    """Return the present command line; empty for calls from Python."""
    return _COMMAND.get()
