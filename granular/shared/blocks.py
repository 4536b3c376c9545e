"""Blocks (headings, texts, tables, ...) of which results are composed for terminals, pages and notebooks."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TextIO

from granular.shared.errors import printable
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
    """A highlighted warning."""

    words: str


class Items(NamedTuple):
    """A list of short texts."""

    items: Sequence[str]


@dataclasses.dataclass(frozen=True)
class Table:
    """Rows of cells below a header; ValueError is raised if a row and the header differ in length."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(
                f"a row of the table with the header {list(self.header)} has too many or too few cells"
            )

    @property
    def has_header(self) -> bool:
        """True if at least one column has a name."""
        return any(self.header)

    def __str__(self) -> str:
        cells = [[" ".join(str(cell).split("\n")) for cell in row] for row in self.rows]
        return align_columns([self.header, *cells] if self.has_header else cells) if cells else ""


class Printout(NamedTuple):
    """Lines in a fixed-width font, such as a scene's text."""

    words: str


class Equation(NamedTuple):
    """A formula as MathML, and as plain text for a terminal."""

    mathml: str
    words: str = ""


class Picture(NamedTuple):
    """A picture that is drawn on demand."""

    draw: Callable[[], Figure]
    caption: str


class CustomBlock(Protocol):
    """Custom block with HTML for pages and notebooks; ``str(block)`` is the text for terminals."""

    def _repr_html_(self) -> str: ...


Block = Heading | Text | Caution | Items | Table | Printout | Equation | Picture | CustomBlock

_BLOCKS = (Heading, Text, Caution, Items, Table, Printout, Equation, Picture)

ADDED_BLOCKS = Registry[Callable[[Any], Iterable[Block]]](
    "report block", "granular.blocks", {}, lambda _, make: callable(make), "a function of a result"
)
"""Functions of installed packages; each returns the blocks that it adds to a result's page, or ()."""


def blocks_added_by_packages(result: object) -> Iterator[Block]:
    """Yield the blocks that installed packages add to a result's page, and a caution for each failure."""
    working, errors = ADDED_BLOCKS.load()
    yield from make_cautions(map(str, errors.values()))
    for name, make in working.items():
        try:
            blocks = list(make(result))
            for block in blocks:
                if not isinstance(block, _BLOCKS):
                    block._repr_html_()
        except Exception as error:
            blocks = make_cautions([f"{ADDED_BLOCKS.origin(name)} fails: {type(error).__name__}: {error}"])
        yield from blocks


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """Join each row of texts to a line, with columns as wide as their widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def make_cautions(texts: Iterable[str]) -> list[Block]:
    """Make a caution of each text."""
    return [Caution(words) for words in texts]


def format_number(value: float, digits: int = 4) -> str:
    """Format a number for a table."""
    return f"{value:.{digits}g}"


COLUMNS = 100
"""Maximum number of characters in a printed line."""
_SIGNS = {sign: f"\\{sign}" for sign in "{}$&#%_"} | {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}


def blocks_text(blocks: Iterable[Block]) -> str:
    """Write blocks as plain text, without pictures."""
    return "\n".join(text for text in map(block_text, _drop_empty_headings(blocks)) if text)


def _drop_empty_headings(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks without the headings of empty sections."""
    heading: Heading | None = None
    for block in blocks:
        if isinstance(block, Heading):
            heading = block
        elif block_text(block):
            if heading is not None:
                yield heading
            heading = None
            yield block


def block_text(block: Block) -> str:
    """Write a block as plain text."""
    match block:
        case Heading(words):
            return f"\n{words}"
        case Text(words):
            return wrap(words)
        case Printout(words):
            return words
        case Caution(words):
            return wrap(f"caution: {words}", "  ")
        case Items(items):
            return "\n".join(wrap(f"  {words}", "    ") for words in items)
        case Table():
            return str(block)
        case Equation(_, words):
            return wrap(words)
        case Picture():
            return ""
        case _:
            return str(block)


def wrap(words: str, later: str = "") -> str:
    """Break lines at spaces, to at most `COLUMNS` characters."""
    lines = (
        textwrap.fill(line, COLUMNS, subsequent_indent=later, break_long_words=False, break_on_hyphens=False)
        for line in words.split("\n")
    )
    return "\n".join(lines)


def print_blocks(blocks: Iterable[Block], stream: TextIO) -> None:
    """Print blocks; on a terminal, tables have rules and are fitted to the width of the terminal."""
    for block in _drop_empty_headings(blocks):
        if isinstance(block, Table) and stream.isatty():
            _print_table(block, stream)
        elif text := block_text(block):
            print(printable(text), file=stream)


def _print_table(table: Table, stream: TextIO) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table as RuledTable
    from rich.text import Text as PlainText

    ruled = RuledTable(box=box.SIMPLE, show_header=table.has_header)
    for cell in table.header:
        ruled.add_column(PlainText(printable(cell)), overflow="fold")
    for row in table.rows:
        ruled.add_row(*(PlainText(printable(cell)) for cell in row))
    Console(file=stream).print(ruled)


def latex_inline_text(text: object) -> str:
    """Format a text for use inside a formula."""
    return r"\text{" + "".join(_SIGNS.get(sign, sign) for sign in printable(text)) + "}"


def latex_array(table: Table) -> str:
    """Format a table as a displayed LaTeX array, flush left."""
    lines = [" & ".join(map(latex_inline_text, row)) + r" \\" for row in table.rows]
    if table.has_header:
        lines = [" & ".join(map(latex_inline_text, table.header)) + r" \\ \hline", *lines]
    body = "\n".join(lines)
    columns = "l" * len(table.header)
    return f"$$\\begin{{array}}{{{columns}}}\n{body}\n\\end{{array}}$$"


def latex_lines(lines: str) -> str:
    """Format a text of several lines as a displayed LaTeX array."""
    return latex_array(Table(("",), [[line] for line in lines.splitlines()]))
