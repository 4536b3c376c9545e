"""Tables for people: as plain text, and as LaTeX for notebooks that are printed."""

from __future__ import annotations

from collections.abc import Sequence

from granular.shared.message_text import printable

_SIGNS = {sign: f"\\{sign}" for sign in "{}$&#%_"} | {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """Align rows of texts in columns that are as wide as their widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def latex_inline_text(text: object) -> str:
    """Format a text for use inside of a formula."""
    return r"\text{" + "".join(_SIGNS.get(sign, sign) for sign in printable(text)) + "}"


def latex_array(rows: Sequence[Sequence[object]], header: Sequence[object] = ()) -> str:
    """Format rows of texts as a displayed LaTeX array, flush left."""
    lines = [" & ".join(map(latex_inline_text, row)) + r" \\" for row in rows]
    if header:
        lines = [" & ".join(map(latex_inline_text, header)) + r" \\ \hline", *lines]
    body = "\n".join(lines)
    columns = "l" * max(map(len, rows), default=1)
    return f"$$\\begin{{array}}{{{columns}}}\n{body}\n\\end{{array}}$$"


def latex_lines(lines: str) -> str:
    """Format a text of a few lines as a displayed LaTeX array."""
    return latex_array([[line] for line in lines.splitlines()])
