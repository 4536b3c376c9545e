"""Tables for people: as plain text, and as LaTeX for notebooks that are printed."""

from __future__ import annotations

from collections.abc import Sequence

from granular.shared.message_text import printable

_SIGNS = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\^{}",
    "~": r"\~{}",
}


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """Rows of equally many texts, in columns that are as wide as their widest."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def latex_inline_text(text: object) -> str:
    """Text inside of a formula."""
    return r"\text{" + "".join(_SIGNS.get(sign, sign) for sign in printable(text)) + "}"


def latex_array(rows: Sequence[Sequence[object]], header: Sequence[object] = ()) -> str:
    """Rows of texts as a displayed array, flush left, with a line below the header."""
    lines = [" & ".join(map(latex_inline_text, row)) + r" \\" for row in rows]
    if header:
        lines = [" & ".join(map(latex_inline_text, header)) + r" \\ \hline", *lines]
    body = "\n".join(lines)
    columns = "l" * max(map(len, rows), default=1)
    return f"$$\\begin{{array}}{{{columns}}}\n{body}\n\\end{{array}}$$"


def latex_lines(lines: str) -> str:
    """Text of a few lines."""
    return latex_array([[line] for line in lines.splitlines()])
