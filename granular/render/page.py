"""The page of a picture: axes to scale, and the walls."""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.effects.walls import Wall
from granular.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, WALL = "#22292f", "#8a949c"
DPI = 120
"""Pixels an inch of movies."""

WIDEST, TALLEST = 5.6, 6.6
"""Greatest width and height of the bed in a picture [inch]."""

LEFT, RIGHT, BOTTOM, TOP = 0.65, 1.75, 0.55, 0.4
"""What stands about the bed: labels, legend, title [inch]."""


def wall_thickness(scene: Scene) -> float:
    """How thick walls and piston are drawn [mm]."""
    return 0.018 * 1e3 * scene.cell.width


CURVE = 1.5
"""Height of what stands below the bed in a movie, with its labels [inch]."""


def new_page(
    scene: Scene, top: float, below: float = 0.0, widest: float = WIDEST
) -> tuple[Figure, Axes, Axes]:
    """A figure with axes in mm, to scale, that hold the bed up to ``top`` [m], and axes beside it.

    ``below`` is left free under the bed, which is at most ``widest`` wide [inch]. The figure's
    width and height are even numbers of pixels at 120 an inch, as movies want them.
    """
    from matplotlib.figure import Figure

    edge = 1.5 * wall_thickness(scene)
    width, height = 1e3 * scene.cell.width + 2.0 * edge, 1e3 * top + 2.0 * edge
    inch = min(widest / width, TALLEST / height)
    size = [
        2.0 * round((start + length * inch + end) * DPI / 2.0) / DPI
        for start, length, end in ((LEFT, width, RIGHT), (BOTTOM + below, height, TOP))
    ]
    figure = Figure(figsize=(size[0], size[1]), dpi=DPI, facecolor="white")
    low = (BOTTOM + below) / size[1]
    bed = (LEFT / size[0], low, width * inch / size[0], height * inch / size[1])
    axes = figure.add_axes(bed)
    axes.set_xlim(-edge, width - edge)
    axes.set_ylim(-edge, height - edge)
    axes.set_aspect("equal", anchor="SW")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.spines[["top", "right", "left", "bottom"]].set_visible(False)
    axes.tick_params(length=2.5, width=0.6, color=WALL)
    side = figure.add_axes((bed[0] + bed[2] + 0.15 / size[0], bed[1], 1.5 / size[0], bed[3]))
    return figure, axes, side


def axes_below(figure: Figure, bed: Axes) -> Axes:
    """Axes in the room that a page has left free below the bed."""
    place = bed.get_position()
    tall = figure.get_figheight()
    return figure.add_axes((place.x0, BOTTOM / tall, place.width, (CURVE - 0.55) / tall))


def draw_walls(axes: Axes, scene: Scene, top: float) -> None:
    """Walls as solid slabs outside of the cell; a side without a wall as a dotted line.

    Parameters
    ----------
    top : float
        Up to where the sides are drawn [m].
    """
    from matplotlib.patches import Rectangle

    width, height, thickness = 1e3 * scene.cell.width, 1e3 * top, wall_thickness(scene)
    walls = scene.effects.walls
    for side, edge in (("left", -thickness), ("right", width)):
        wall = None if walls is None else getattr(walls, side)
        if wall is None:
            place = max(0.0, min(edge, width))
            axes.plot([place, place], [0.0, height], ":", color=WALL, linewidth=1.0, zorder=0)
            continue
        length = height if wall.length is None else min(height, 1e3 * wall.length)
        axes.add_patch(Rectangle((edge, 0.0), thickness, length, color=WALL, linewidth=0.0))
    if scene.cell.periods is not None:
        axes.plot([0.0, width], [height, height], ":", color=WALL, linewidth=1.0, zorder=0)
    bottom = None if walls is None else walls.bottom
    if bottom is None:
        axes.plot([0.0, width], [0.0, 0.0], ":", color=WALL, linewidth=1.0, zorder=0)
        return
    for start, end in _bottom_parts(bottom, width, thickness):
        axes.add_patch(
            Rectangle((start, -thickness), end - start, thickness, color=WALL, linewidth=0.0)
        )


def _bottom_parts(wall: Wall, width: float, thickness: float) -> list[tuple[float, float]]:
    """Where the bottom lies, along x [mm]."""
    start, end = -thickness, width + thickness
    if wall.gap_start is None or wall.gap_end is None:
        return [(start, end)]
    return [(start, 1e3 * wall.gap_start), (1e3 * wall.gap_end, end)]
