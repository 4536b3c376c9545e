"""What the sections share: tables, notes of failures, the size of figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from granular.shared.html import Page
from validation.parts import FAILED, Plain
from validation.table import TextTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 5.6
"""Of a figure [inch]: narrow enough for its letters to be read on a phone."""

LONGEST_NUMBER = 16
"""Letters of a number with its unit; what is longer is words."""


class Shown(NamedTuple):
    """How the results of a part are shown.

    Attributes
    ----------
    text : callable
        Tables for the console, of the results that did not fail.
    verdict : callable
        Words on these results, and whether they hold.
    section : callable
        Adds all results to a page.
    measurements : callable or None
        Adds the tables behind the pictures, which few will read.
    """

    text: Callable[[Sequence[Plain]], str]
    verdict: Callable[[Sequence[Plain]], tuple[str, bool]]
    section: Callable[[Page, Sequence[Plain]], None]
    measurements: Callable[[Page, Sequence[Plain]], None] | None = None


def sound(results: Sequence[Plain]) -> list[Plain]:
    """The results that did not fail."""
    return [one for one in results if FAILED not in one]


def note_failures(page: Page, results: Sequence[Plain]) -> None:
    """A note for each that did."""
    for one in results:
        if FAILED in one:
            page.note(f"{one['label']} failed: {one[FAILED]}")


def tabulate(page: Page, shown: TextTable) -> None:
    """A table whose numbers are not broken."""
    page.table(shown.header, [tuple(map(unbroken, row)) for row in shown.rows])


def unbroken(cell: str) -> str:
    """A number and its unit stay on one line: 1e-06 is not broken at its sign."""
    if "," in cell or len(cell) > LONGEST_NUMBER or not cell.lstrip("+-")[:1].isdigit():
        return cell
    return cell.replace("-", "\u2011").replace(" ", "\u00a0")


def legend(axes: Axes, columns: int = 2) -> None:
    """A legend below the axes."""
    # Below the axes, so that a narrow page leaves the figure wide enough to be read.
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)
