"""Colours, line styles and fonts of all figures."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from granular.shared.errors import sanitize

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#20639b", "#c94c54", "#75a97e", "#b88407", "#8778d0", "#289d8e", "#855020", "#54585e")
"""Colours of lines, which people with any of the three types of colour blindness can distinguish."""
SIDES = {"4 or fewer": "#b35806", "5": "#f1a340", "6": "#e4e2da", "7": "#998ec3", "8 or more": "#542788"}
"""Colours of Voronoi cells by their number of sides, from orange to purple."""
READABLE = 13.5
"""Font size [pt] that is readable on a phone, which shows a figure at half its width."""
ARROWS_TO_SCALE: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "color": "#333333"}
"""Style of arrows with lengths to scale."""
STYLES = ("-", "--", "-.", ":")
GREY = "#9aa5b1"
_LONGEST_LABEL = 60
_LOOKS: WeakKeyDictionary[Figure, Any] = WeakKeyDictionary()


def line_style(index: int) -> dict[str, Any]:
    """Return colour and style of a line by its index; up to 32 lines are distinct."""
    turn, colour = divmod(index, len(COLOURS))
    return {"color": COLOURS[colour], "linestyle": STYLES[(index + turn) % len(STYLES)]}


def figure_label(words: object) -> str:
    """Shorten a user's text for a figure, and escape characters that matplotlib would read as a formula."""
    return sanitize(words, _LONGEST_LABEL).replace("$", r"\$")


def label_log_axis_plainly(axis: Axis) -> None:
    """Label a logarithmic axis by 0.1, 1, 10 instead of powers, whose exponents are too small on a phone."""
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
    """Make a figure and its axes in the common style; width and height in inches, font size in pt."""
    import matplotlib as mpl
    from cycler import cycler
    from matplotlib.figure import Figure as Plain

    style: Any = {
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
    with mpl.rc_context(style):
        drawing = (make or Plain)(figsize=(width, height), layout="constrained")
        _LOOKS[drawing] = style
        yield drawing, drawing.subplots(rows, columns, **options)


def svg_text(drawing: Figure) -> str:
    """Return a figure as SVG text, drawn in the common style."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context(_LOOKS.get(drawing, {})):
        drawing.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def axes_or_new(ax: Axes | None, width: float = 7.2, height: float = 3.4) -> Axes:
    """Return the given axes, or axes of a new figure of this width and height in inches."""
    chosen: Axes = ax or new_axes(width=width, height=height)
    return chosen


def new_axes(rows: int = 1, **options: Any) -> Any:
    """Make a figure in the common style, and return its axes."""
    make = None
    # Notebooks and programs that use pyplot show the figure; otherwise it has no window.
    if "matplotlib.pyplot" in sys.modules or "ipykernel" in sys.modules:
        from matplotlib import pyplot

        make = pyplot.figure
    with figure(rows, make=make, **options) as (_, result):
        return result
