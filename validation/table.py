"""A table for people: on the console and on a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class TextTable(NamedTuple):
    """Header and rows of texts."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """The table in columns."""
        lines = [self.header, *self.rows]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.header))]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> TextTable:
    """A table of anything that can be written."""
    return TextTable(tuple(header), tuple(tuple(map(str, row)) for row in rows))
