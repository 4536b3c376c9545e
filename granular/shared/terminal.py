"""Blocks for a terminal, and as plain text for files and pipes; tables as LaTeX for printed notebooks."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import TextIO

from granular.shared.blocks import Block, Caution, Equation, Heading, Items, Picture, Printout, Table, Text
from granular.shared.errors import printable

COLUMNS = 100
"""Letters of a line."""
_SIGNS = {sign: f"\\{sign}" for sign in "{}$&#%_"} | {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}


def blocks_text(blocks: Iterable[Block]) -> str:
    """Write blocks as plain text; pictures are left to pages."""
    return "\n".join(text for text in map(block_text, _filled_sections(blocks)) if text)


def _filled_sections(blocks: Iterable[Block]) -> Iterator[Block]:
    """Leave away headings behind which nothing can be written."""
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
    """Break lines at spaces, after at most `COLUMNS` letters."""
    lines = (
        textwrap.fill(line, COLUMNS, subsequent_indent=later, break_long_words=False, break_on_hyphens=False)
        for line in words.split("\n")
    )
    return "\n".join(lines)


def print_blocks(blocks: Iterable[Block], stream: TextIO) -> None:
    """Print blocks; on a terminal their tables are ruled, and broken to its width."""
    for block in _filled_sections(blocks):
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
    """Format a text for use inside of a formula."""
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
    """Format a text of a few lines as a displayed LaTeX array."""
    return latex_array(Table(("",), [[line] for line in lines.splitlines()]))
