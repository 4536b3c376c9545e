"""What installed distributions offer by entry points: looked up by name, and loaded then."""

from __future__ import annotations

import importlib.metadata
from typing import Any

from granular.shared.errors import InputError
from granular.shared.messages import quoted


def offered(group: str, name: str, what: str) -> Any | None:
    """What a distribution offers under a name; None where none does.

    Parameters
    ----------
    group : str
        Of the entry points.
    name : str
    what : str
        What it is, for the message.

    Raises
    ------
    InputError
        If it cannot be loaded.
    """
    for point in importlib.metadata.entry_points(group=group, name=name):
        try:
            return point.load()
        except (ImportError, AttributeError, InputError) as error:
            raise InputError(
                f"{what} {quoted(name)} cannot be loaded: {error}; mend the distribution that "
                f"offers it as {quoted(point.value)}"
            ) from None
    return None


def names_offered(group: str) -> tuple[str, ...]:
    """The names that distributions offer."""
    return tuple(point.name for point in importlib.metadata.entry_points(group=group))
