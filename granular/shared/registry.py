"""Things by their names: tables that show themselves, and what installed distributions add."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from granular.shared.errors import InputError
from granular.shared.message_text import quote

Named = TypeVar("Named")


class Registry(dict[str, Named]):
    """Things by their names; printed, each has a line with what it is."""

    def __init__(self, things: Iterable[tuple[str, Named]], said: Callable[[Named], str]) -> None:
        super().__init__(things)
        self._said = said

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        return "\n".join(f"{name:{width}}  {words}" for name, words in self.descriptions().items())

    def descriptions(self) -> dict[str, str]:
        """Describe each thing in a line: a dict by its name."""
        return {name: self._said(thing) for name, thing in self.items()}


def load_entry_point(group: str, name: str, what: str) -> Any | None:
    """Load the object that an installed distribution offers under a name."""
    for point in importlib.metadata.entry_points(group=group, name=name):
        try:
            return point.load()
        except (ImportError, AttributeError, InputError) as error:
            raise InputError(
                f"{what} {quote(name)} cannot be loaded: {error}; correct {quote(point.value)}"
            ) from None
    return None


def entry_point_names(group: str) -> tuple[str, ...]:
    """Names of the entry points that installed distributions offer."""
    return tuple(point.name for point in importlib.metadata.entry_points(group=group))
