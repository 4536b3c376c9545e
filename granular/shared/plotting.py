"""One look for all figures."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from granular.shared.message_text import sanitize

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#20639b", "#c94c54", "#75a97e", "#b88407", "#8778d0", "#289d8e", "#855020", "#54585e")
"""Line colours, told apart by colour-blind eyes of all three kinds too."""
SIDES = {"4 or fewer": "#b35806", "5": "#f1a340", "6": "#e4e2da", "7": "#998ec3", "8 or more": "#542788"}
"""Colours of Voronoi cells by their number of sides, from orange to purple."""
READABLE = 13.5
"""Size of letters [pt] that can be read on a phone, where a figure is half as wide."""
STYLES = ("-", "--", "-.", ":")
GREY = "#9aa5b1"
_LONGEST_LABEL = 60


def line_style(index: int) -> dict[str, Any]:
    """Choose colour and style of one of up to 32 lines, of which no two are alike.

    Parameters
    ----------
    index : int
        Index of the line.

    Returns
    -------
    dict
        ``color`` and ``linestyle`` for Matplotlib.
    """
    turn, colour = divmod(index, len(COLOURS))
    return {"color": COLOURS[colour], "linestyle": STYLES[(index + turn) % len(STYLES)]}


def figure_label(words: object) -> str:
    """Shorten a user's words for a figure, so that they are no formula to be set.

    Parameters
    ----------
    words : object
        Words of the user.

    Returns
    -------
    str
        At most 60 characters; dollar signs are escaped.
    """
    return sanitize(words, _LONGEST_LABEL).replace("$", r"\$")


def label_log_axis_plainly(axis: Axis) -> None:
    """Label a logarithmic axis 0.1, 1, 10: exponents of powers are too small on a phone.

    Parameters
    ----------
    axis : Axis
        Axis of Matplotlib.
    """
    from matplotlib.ticker import LogFormatterSciNotation

    class Plain(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(Plain())


@contextlib.contextmanager
def figure(
    rows: int = 1,
    columns: int = 1,
    *,
    width: float = 7.2,
    height: float = 3.4,
    size: float = 10.0,
    make: Callable[..., Figure] | None = None,
    **options: Any,
) -> Iterator[tuple[Figure, Any]]:
    """Make a figure and its axes in the common look.

    ``size`` is that of its letters [pt].

    Parameters
    ----------
    rows, columns : int
        Number of axes below and next to each other.
    width, height : float
        Size of the figure [inches].
    size : float
        Size of its letters [pt].
    make : function, optional
        Maker of the figure, such as that of pyplot; without it the figure has no window.
    **options
        Options of ``Figure.subplots``.

    Yields
    ------
    tuple of Figure and Axes
        Figure, and its axes: one, or an array (rows, columns).
    """
    import matplotlib as mpl
    from cycler import cycler
    from matplotlib.figure import Figure as Plain

    look: Any = {
        "font.size": size,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.prop_cycle": cycler(color=COLOURS),
        "legend.frameon": False,
        "svg.fonttype": "path",
        "path.simplify": True,
        "path.simplify_threshold": 0.2,
    }
    with mpl.rc_context(look):
        drawing = (make or Plain)(figsize=(width, height), layout="constrained")
        yield drawing, drawing.subplots(rows, columns, **options)


def axes_or_new(ax: Axes | None, width: float = 7.2, height: float = 3.4) -> Axes:
    """Return the axes, or those of a new figure.

    Parameters
    ----------
    ax : Axes or None
        Axes of Matplotlib.
    width, height : float
        Size of a new figure [inches].

    Returns
    -------
    Axes
        Axes to draw on.
    """
    if ax is not None:
        return ax
    new: Axes = new_axes(width=width, height=height)
    return new


def new_axes(rows: int = 1, **options: Any) -> Any:
    """Make a figure in the common look, and return its axes.

    A notebook, or a program that uses pyplot, shows the figure; elsewhere it has no window.

    Parameters
    ----------
    rows : int
        Number of axes below each other.
    **options
        Options of `figure`.

    Returns
    -------
    Axes
        One axes, or an array (rows,).
    """
    make = None
    if "matplotlib.pyplot" in sys.modules or "ipykernel" in sys.modules:
        from matplotlib import pyplot

        make = pyplot.figure
    with figure(rows, make=make, **options) as (_, result):
        return result
