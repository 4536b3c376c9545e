"""Results as self-contained HTML files, readable on a wide screen and on a phone."""

from __future__ import annotations

import dataclasses
import datetime
import html
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from granular.shared.blocks import (
    Block,
    Caution,
    Equation,
    Heading,
    Items,
    Picture,
    Printout,
    Table,
    Text,
    blocks_added_by_packages,
    blocks_text,
)
from granular.shared.errors import printable
from granular.shared.files import write_text
from granular.shared.plotting import svg_text
from granular.shared.version import toolkit_and_library_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HERE = Path(__file__).parent
MIN_FONT_SIZE = 9.0
"""Minimum readable font size [pixels]."""
LONGEST_NUMBER = 16
"""Maximum number of characters of a cell with a number and its unit; longer cells are treated as text."""


def page_footer(libraries: Sequence[str] = ()) -> str:
    """Return the footer of a page: date, and versions of the toolkit and of libraries."""
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    return f"Made on {now} with " + ", ".join(
        f"{k} {v}" for k, v in toolkit_and_library_versions(libraries).items()
    )


class ResultShownAsBlocks:
    """Base class of results that are displayed by their blocks, as text and in a notebook."""

    def blocks(self) -> Iterable[Block]:
        """Blocks that display the result."""
        raise NotImplementedError

    def __str__(self) -> str:
        return blocks_text(self.blocks())

    def _repr_html_(self) -> str:
        return blocks_html(self.blocks())


@dataclasses.dataclass(frozen=True)
class Page:
    """Page of blocks that a notebook displays and `save` writes to an HTML file."""

    title: str
    lead: str = ""
    blocks: Sequence[Block] = ()
    footer: str = dataclasses.field(default_factory=page_footer)
    result: dataclasses.InitVar[object] = None  # result on this page, to which packages may add blocks

    def __post_init__(self, result: object) -> None:
        if result is not None:
            object.__setattr__(self, "blocks", (*self.blocks, *blocks_added_by_packages(result)))

    def to_html(self) -> str:
        """Return the complete page as HTML."""
        lead = f'<p class="lead">{_escape(self.lead)}</p>' if self.lead else ""
        body = "\n".join([f"<h1>{_escape(self.title)}</h1>", lead, *map(_block_html, self.blocks)])
        names = ("page.css", "page.js")
        style, script = (_HERE.joinpath(name).read_text(encoding="utf-8") for name in names)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{_escape(self.title)}</title>\n<style>\n{style}</style></head>\n"
            f"<body>\n{body}\n<footer>{_escape(self.footer)}</footer>\n"
            f"<script>\n{script}</script></body></html>\n"
        )

    def save(self, path: str | Path) -> None:
        """Write the page to an HTML file."""
        write_text(Path(path), self.to_html())

    def __str__(self) -> str:
        return blocks_text([Heading(self.title), Text(self.lead), *self.blocks])

    def _repr_html_(self) -> str:
        return blocks_html([Heading(self.title), Text(self.lead), *self.blocks])


def _escape(words: object) -> str:
    """Escape a text for HTML, also within quotes, and remove control characters."""
    return html.escape(printable(words), quote=True)


def blocks_html(blocks: Iterable[Block]) -> str:
    """Write blocks as HTML for a notebook."""
    return "\n".join(map(_block_html, blocks))


def _block_html(block: Block) -> str:
    match block:
        case Heading(words):
            return f"<h2>{_escape(words)}</h2>"
        case Text(words):
            return f"<p>{_escape(words)}</p>" if words else ""
        case Caution(words):
            return f'<p class="note">{_escape(words)}</p>'
        case Items(items):
            return f"<ul>{''.join(f'<li>{_escape(words)}</li>' for words in items)}</ul>"
        case Printout(words):
            return f"<pre>{_escape(words)}</pre>"
        case Equation(mathml, _):
            return f'<div class="equation">{mathml}</div>'
        case Table():
            return _table_html(block)
        case Picture():
            return _picture_html(block)
        case _:
            return block._repr_html_()


def _table_html(table: Table) -> str:
    """Return the HTML of a table, which can be scrolled if it is wider than the page."""
    head = "".join(f"<th>{_escape(cell)}</th>" for cell in table.header)
    body = "".join(f"<tr>{''.join(map(_cell_html, row))}</tr>" for row in table.rows)
    head = f"<thead><tr>{head}</tr></thead>" if table.has_header else ""
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


def _cell_html(cell: object) -> str:
    """Return the HTML of a cell, with a number, its sign and its unit on one line."""
    words = str(cell)
    is_number = words.lstrip("+-±<")[:1].isdigit() and len(words) <= LONGEST_NUMBER and "," not in words
    return f"<td{' class=number' if is_number else ''}>{_escape(words)}</td>"


def _picture_html(picture: Picture) -> str:
    """Return the HTML of a figure as SVG."""
    drawing = picture.draw()
    svg = svg_text(drawing)
    caption = _escape(picture.caption)
    # On a phone the figure keeps a readable width, and scrolls.
    style = f"--least:{_minimum_readable_width(drawing):.0f}px"
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{caption}" style="{style}"', 1)
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def _minimum_readable_width(drawing: Figure) -> float:
    """Return the minimum width [pixels] at which the smallest letters of a figure are readable."""
    from matplotlib.text import Text

    texts = [text for text in drawing.findobj(Text) if isinstance(text, Text) and text.get_text()]
    smallest = min((float(text.get_fontsize()) for text in texts), default=math.inf)
    return MIN_FONT_SIZE * 72.0 * drawing.get_figwidth() / smallest
