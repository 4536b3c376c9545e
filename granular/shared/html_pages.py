"""Pages: one HTML file with everything in it, readable on a wide screen and on a phone."""

from __future__ import annotations

import dataclasses
import html
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.shared.files import write_text
from granular.shared.message_text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DATA, _TITLE = "{{data}}", "{{title}}"
"""Marks in a template of a page that moves."""

LEAST_LETTERS = 9.0
"""Size of letters that can be read [pixels]."""
_STYLE = """
:root { color-scheme: light dark; --ink: #1c2733; --paper: #ffffff; --line: #d5dce3;
  --soft: #f4f6f8; --accent: #20639b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6ebf0; --paper: #14191f; --line: #37424d;
  --soft: #1d242c; --accent: #7db4e6; } }
* { box-sizing: border-box; }
body { font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  color: var(--ink); background: var(--paper); margin: 0 auto; padding: 1rem; max-width: 60rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0.6rem 0; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-bottom: 1px solid var(--line); }
p.lead { font-size: 1.05rem; }
figure { margin: 1rem 0; overflow-x: auto; }
figure svg { width: 100%; max-width: 46rem; height: auto; background: #ffffff; border-radius: 4px; }
figure img { max-width: 100%; height: auto; }
figcaption, footer, .small { font-size: 0.87rem; opacity: 0.85; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.92rem; }
th, td { padding: 0.25rem 0.8rem 0.25rem 0; text-align: left; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { font-weight: 600; }
.equation { font-size: 1.25rem; padding: 0.6rem 0.8rem; background: var(--soft);
  border-left: 4px solid var(--accent); overflow-x: auto; margin: 0.8rem 0; line-height: 2; }
math { font-family: "Latin Modern Math", "STIX Two Math", "Cambria Math", "DejaVu Math TeX Gyre", math; }
.note { background: var(--soft); border-left: 4px solid #d1495b; padding: 0.5rem 0.8rem; }
pre { background: var(--soft); padding: 0.6rem 0.8rem; overflow-x: auto; font-size: 0.85rem; }
@media (max-width: 30rem) { table { font-size: 0.72rem; } pre { white-space: pre-wrap; }
  th, td { padding-right: 0.25rem; hyphens: auto; }
  .equation { font-size: 1.05rem; padding: 0.5rem; }
  figure svg { min-width: var(--least); } }
@page { size: A4; margin: 15mm; }
@media print { :root { --ink: #000000; --paper: #ffffff; --line: #999999; --soft: #ffffff; }
  body { max-width: none; padding: 0; font-size: 10.5pt; } h2 { break-after: avoid; }
  figure, tr, pre, .note { break-inside: avoid; } .scroll, figure { overflow: visible; }
  pre { white-space: pre-wrap; border: 1px solid var(--line); } }
footer { margin-top: 2.5rem; border-top: 1px solid var(--line); padding-top: 0.6rem; }
"""


def _escape(words: object) -> str:
    """Text as HTML, also between quotes, and without control characters."""
    return html.escape(printable(words), quote=True)


def preformatted_html(words: object) -> str:
    """Format a text of many lines as an HTML element ``pre``."""
    return f"<pre>{_escape(words)}</pre>"


def paragraph_html(words: object) -> str:
    """Format a text as an HTML paragraph."""
    return f"<p>{_escape(words)}</p>"


def table_html(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format a table as HTML."""
    head = "".join(f"<th>{_escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{_escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _least_readable_width(drawing: Figure) -> float:
    """Least width of a figure whose smallest letters can be read [pixels]."""
    from matplotlib.text import Text

    texts = [text for text in drawing.findobj(Text) if isinstance(text, Text) and text.get_text()]
    smallest = min((float(text.get_fontsize()) for text in texts), default=math.inf)
    return LEAST_LETTERS * 72.0 * drawing.get_figwidth() / smallest


class HtmlPage:
    """An HTML page that grows from top to bottom."""

    def __init__(self, title: str, lead: str = "") -> None:
        self.title = title
        self._parts = [f"<h1>{_escape(title)}</h1>"]
        if lead:
            self._parts.append(f'<p class="lead">{_escape(lead)}</p>')

    def add_section(self, title: str) -> None:
        """Add the heading of a section."""
        self._parts.append(f"<h2>{_escape(title)}</h2>")

    def add_paragraph(self, words: str) -> None:
        """Add a paragraph."""
        self._parts.append(paragraph_html(words))

    def add_warning(self, words: str) -> None:
        """Add a paragraph that must not be overlooked."""
        self._parts.append(f'<p class="note">{_escape(words)}</p>')

    def add_list(self, items: Sequence[str]) -> None:
        """Add a list of short texts."""
        rows = "".join(f"<li>{_escape(words)}</li>" for words in items)
        self._parts.append(f"<ul>{rows}</ul>")

    def add_preformatted(self, words: str) -> None:
        """Add a text of many lines, in letters of one width."""
        self._parts.append(preformatted_html(words))

    def add_equation(self, mathml: str) -> None:
        """Add a formula."""
        self._parts.append(f'<div class="equation">{mathml}</div>')

    def add_table(self, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Add a table, which scrolls where it is wider than the page."""
        self._parts.append(f'<div class="scroll">{table_html(header, rows)}</div>')

    def add_figure(self, drawing: Figure, caption: str) -> None:
        """Add a figure of Matplotlib as SVG, whose lines stay sharp at any size."""
        buffer = io.StringIO()
        drawing.savefig(buffer, format="svg", metadata={"Date": None})
        svg = buffer.getvalue()
        svg = svg[svg.index("<svg") :]
        label = _escape(caption)
        # On a phone the figure keeps a width at which its letters can be read, and scrolls.
        look = f"--least:{_least_readable_width(drawing):.0f}px"
        svg = svg.replace("<svg", f'<svg role="img" aria-label="{label}" style="{look}"', 1)
        self._parts.append(f"<figure>{svg}<figcaption>{_escape(caption)}</figcaption></figure>")

    def add_footer(self, words: str) -> None:
        """Add small letters at the end of the page."""
        self._parts.append(f"<footer>{_escape(words)}</footer>")

    def to_html(self) -> str:
        """HTML of the whole page, as one text."""
        body = "\n".join(self._parts)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{_escape(self.title)}</title>\n<style>{_STYLE}</style></head>\n"
            f"<body>\n{body}\n</body></html>\n"
        )

    def save(self, path: str | Path) -> None:
        """Write the page to an HTML file."""
        write_text(Path(path), self.to_html())


@dataclasses.dataclass(frozen=True, repr=False)
class InteractivePage:
    """A page that a notebook shows, and that `save` writes for any browser."""

    title: str
    page: str
    height: int  # in a notebook [pixels]

    @classmethod
    def from_template(
        cls, template: Path, title: str, data: Mapping[str, Any], height: int
    ) -> InteractivePage:
        """Fill an HTML template with slots for the title and its script's data; height [pixels]."""
        # A text in the data must not end the script.
        plain = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
        page = template.read_text(encoding="utf-8").replace(_TITLE, html.escape(title))
        return cls(title, page.replace(_DATA, plain), height)

    def __repr__(self) -> str:
        return f"{self.title}: shown by a notebook; .save('view.html') writes it for a browser"

    def _repr_html_(self) -> str:
        inside = html.escape(self.page, quote=True)
        return (
            f'<iframe srcdoc="{inside}" title="{html.escape(self.title, quote=True)}" '
            f'style="width:100%;height:{self.height}px;border:0"></iframe>'
        )

    def save(self, path: str | Path) -> None:
        """Write the page to an HTML file."""
        write_text(Path(path), self.page)


def format_number(value: float, digits: int = 4) -> str:
    """Format a number for a table."""
    return f"{value:.{digits}g}"
