"""A table for people: on the console and on a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from granular.shared.tables import in_columns


class TextTable(NamedTuple):
    """Header and rows of texts."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """The table in columns."""
        return in_columns([self.header, *self.rows])


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> TextTable:
    """A table of anything that can be written."""
    return TextTable(tuple(header), tuple(tuple(map(str, row)) for row in rows))
