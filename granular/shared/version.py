"""Version of the toolkit, and the command that is being carried out."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextvars import ContextVar

__version__ = "0.1.0"


def versions(more: Sequence[str] = ()) -> dict[str, str]:
    """Versions of the toolkit and of what it computes with, and the kind of machine."""
    import importlib.metadata
    from platform import machine, python_version

    result = {"python": python_version(), "machine": machine(), "granular-damper": __version__}
    for name in ("numpy", "numba", *more):  # numba may be missing where nothing is simulated
        try:
            result[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return result


_COMMAND: ContextVar[str] = ContextVar("command", default="")


def set_command(program: str, arguments: Sequence[str]) -> None:
    """Keep the command line that is carried out from now on."""
    _COMMAND.set(shlex.join([*program.split(), *arguments]))


def current_command() -> str:
    """Return the command line that is being carried out; empty where Python calls the functions itself."""
    return _COMMAND.get()
