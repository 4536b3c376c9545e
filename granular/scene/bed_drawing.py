"""A bed to scale in axes of Matplotlib, and the pieces of its cell that every picture draws."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.schema.cell import CELL, PISTON, Point, SideLine
from granular.shared.plotting import COLOURS

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes

    from granular.scene.scene import Scene


class SidePiece(NamedTuple):
    """A straight piece of a side."""

    line: SideLine
    walled: bool  # not open
    start: Point  # [m]
    end: Point  # [m]


def side_pieces(scene: Scene, body: int, height: float, top: float) -> Iterator[SidePiece]:
    """Yield the sides of a body, without the gaps in them; height of the piston, and of the picture [m]."""
    walls = scene.effects.walls
    for line in scene.cell.lines:
        if line.body != body:
            continue
        wall = None if walls is None else getattr(walls, line.name)
        (x, y), end = line.ends(height, top)
        marks = [0.0, float(np.hypot(end[0] - x, end[1] - y))]
        if wall is not None and wall.length is not None:
            marks[1] = min(marks[1], wall.length)
        if wall is not None and wall.gap_start is not None and wall.gap_end is not None:
            marks[1:1] = wall.gap_start, wall.gap_end
        points = [(x + s * line.tangent[0], y + s * line.tangent[1]) for s in marks]
        for start, stop in zip(points[::2], points[1::2], strict=True):
            yield SidePiece(line, wall is not None, start, stop)


def draw_bed(
    axes: Axes, scene: Scene, positions: Float[np.ndarray, "n 2"], piston_height: float | None
) -> None:
    """Draw the grains to scale, the cell and the piston; positions, piston_height [m]."""
    from matplotlib.collections import EllipseCollection

    diameters = 1e3 * scene.grains.diameters()
    grains = EllipseCollection(
        diameters,
        diameters,
        np.zeros(len(diameters)),
        units="xy",
        offsets=1e3 * positions,
        offset_transform=axes.transData,
        linewidths=0.0,
        facecolors=[COLOURS[k % len(COLOURS)] for k in scene.grains.species_indices()],
    )
    axes.add_collection(grains)
    width = 1e3 * scene.cell.width
    top = piston_height if piston_height is not None else float(positions[:, 1].max())
    bodies = [(CELL, "#333333", 1.5)]
    if piston_height is not None:
        bodies.append((PISTON, COLOURS[1], 3.0))
    for body, colour, thickness in bodies:
        for piece in side_pieces(scene, body, top, top):
            x, y = 1e3 * np.transpose([piece.start, piece.end])
            axes.plot(x, y, color=colour, linewidth=thickness)
    style_as_map(axes)
    axes.set_xlim(-0.01 * width, 1.01 * width)
    axes.set_ylim(-0.01 * width, 1e3 * top + 0.02 * width)


def style_as_map(ax: Axes) -> Axes:
    """Draw axes to scale, without a grid, in millimetres."""
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.grid(visible=False)
    ax.set(xlabel="x [mm]", ylabel="y [mm]")
    return ax
