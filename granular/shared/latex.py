"""Texts and tables as LaTeX, for notebooks that are printed; MathJax sets them too."""

from __future__ import annotations

from collections.abc import Sequence

from granular.shared.messages import printable

_SIGNS = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\^{}", "~": r"\~{}",
}  # fmt: skip


def words(text: object) -> str:
    """A text inside of a formula."""
    return r"\text{" + "".join(_SIGNS.get(sign, sign) for sign in printable(text)) + "}"


def array(rows: Sequence[Sequence[object]], header: Sequence[object] = ()) -> str:
    """Rows of texts as a displayed array, flush left, with a line below the header."""
    lines = [" & ".join(map(words, row)) + r" \\" for row in rows]
    if header:
        lines = [" & ".join(map(words, header)) + r" \\ \hline", *lines]
    body = "\n".join(lines)
    columns = "l" * max(map(len, rows), default=1)
    return f"$$\\begin{{array}}{{{columns}}}\n{body}\n\\end{{array}}$$"


def text(lines: str) -> str:
    """A text of a few lines."""
    return array([[line] for line in lines.splitlines()])
