"""Blocks by which results are shown: plain data, rendered for a page, a terminal and a notebook."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from granular.shared.registry import Registry

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Heading(NamedTuple):
    """Heading of a section."""

    words: str


class Text(NamedTuple):
    """A paragraph."""

    words: str


class Caution(NamedTuple):
    """A paragraph that must not be overlooked."""

    words: str


class Items(NamedTuple):
    """A list of short texts."""

    items: Sequence[str]


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of cells below a header; rows of another width than the header raise ValueError."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"rows of a table with the header {list(self.header)} have other widths")

    @property
    def has_header(self) -> bool:
        """Return true if a column has a name."""
        return any(self.header)

    def __str__(self) -> str:
        cells = [[" ".join(str(cell).split("\n")) for cell in row] for row in self.rows]
        return align_columns([self.header, *cells] if self.has_header else cells) if cells else ""


class Printout(NamedTuple):
    """Lines in letters of one width, such as a scene's text."""

    words: str


class Equation(NamedTuple):
    """A formula as MathML, and as a terminal writes it."""

    mathml: str
    words: str = ""


class Picture(NamedTuple):
    """A figure, drawn when a page needs it."""

    draw: Callable[[], Figure]
    caption: str


class OwnBlock(Protocol):
    """A block of another kind: its HTML for pages and notebooks; `str` is its text for a terminal."""

    def _repr_html_(self) -> str: ...


Block = Heading | Text | Caution | Items | Table | Printout | Equation | Picture | OwnBlock

ADDED_BLOCKS = Registry[Callable[[Any], Iterable[Block]]](
    "report block", "granular.blocks", {}, lambda _, make: callable(make), "a function of a result"
)
"""Functions by which packages add blocks to the page of a result; they return () for other results."""


def added_blocks(result: object) -> Iterator[Block]:
    """Blocks that packages add to the page of a result, and a caution for each function that fails."""
    working, errors = ADDED_BLOCKS.load()
    yield from cautions(map(str, errors.values()))
    for name, make in working.items():
        try:
            blocks = list(make(result))
        except Exception as error:
            blocks = cautions([f"{ADDED_BLOCKS.origin(name)} fails: {type(error).__name__}: {error}"])
        yield from blocks


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """Align rows of texts in columns that are as wide as their widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def cautions(texts: Iterable[str]) -> list[Block]:
    """Make a caution of each text."""
    return [Caution(words) for words in texts]


def format_number(value: float, digits: int = 4) -> str:
    """Format a number for a table."""
    return f"{value:.{digits}g}"
