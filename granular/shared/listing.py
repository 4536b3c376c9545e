"""Tables of named things that show themselves, a line each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Named = TypeVar("Named")


class Listing(dict[str, Named]):
    """Things by their names; printed, each has a line with what it is."""

    def __init__(self, things: Iterable[tuple[str, Named]], said: Callable[[Named], str]) -> None:
        super().__init__(things)
        self._said = said

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        return "\n".join(f"{name:{width}}  {words}" for name, words in self.words().items())

    def words(self) -> dict[str, str]:
        """What each thing is, by its name."""
        return {name: self._said(one) for name, one in self.items()}
