"""Tables and figures for people: on the console and on a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from granular.shared.terminal import align_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.shared.html_pages import HtmlPage

WIDTH = 5.6
"""Width of a figure [inch]: narrow enough for its letters to be read on a phone."""

LONGEST_NUMBER = 16
"""Letters of a number with its unit; what is longer is words."""


class TextTable(NamedTuple):
    """Header and rows of texts."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Table as text in aligned columns."""
        return align_columns([self.header, *self.rows])


def text_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> TextTable:
    """Make a table of texts from anything that can be written."""
    return TextTable(tuple(header), tuple(tuple(map(str, row)) for row in rows))


def add_table_to_page(page: HtmlPage, shown: TextTable) -> None:
    """Add a table to a page, its numbers kept on one line."""
    page.add_table(shown.header, [tuple(map(keep_number_with_unit, row)) for row in shown.rows])


def keep_number_with_unit(cell: str) -> str:
    """Keep a number and its unit on one line: 1e-06 is not broken at its sign."""
    if "," in cell or len(cell) > LONGEST_NUMBER or not cell.lstrip("+-")[:1].isdigit():
        return cell
    return cell.replace("-", "\u2011").replace(" ", "\u00a0")


def draw_legend_below(axes: Axes, columns: int = 2) -> None:
    """Draw a legend below the axes of a figure."""
    # Below the axes, so that a narrow page leaves the figure wide enough to be read.
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)
