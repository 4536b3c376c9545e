"""Drawings of a bed to scale with Matplotlib, and the sides of its cell for all pictures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.schema.cell import CELL, PISTON, Point, SideLine
from granular.shared.array_types import Float
from granular.shared.plotting import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.scene.scene import Scene


class SidePiece(NamedTuple):
    """A straight piece of a side of the cell."""

    line: SideLine
    walled: bool  # True unless the side is open
    start: Point  # [m]
    end: Point  # [m]


def body_index_of_side(scene: Scene, line: SideLine) -> int:
    """Return the index of a side's body: 0 for the cell, 1 for the piston, 2 or more for further pistons."""
    pistons = () if scene.effects.host is None else scene.effects.host.pistons
    names = [other.side for other in pistons]
    return PISTON + 1 + names.index(line.name) if line.name in names else line.body


def side_pieces(scene: Scene, body: int, top: float) -> Iterator[SidePiece]:
    """Yield the pieces of a body's sides between gaps, with the body at height 0, up to ``top`` [m]."""
    walls = scene.effects.walls
    for line in scene.cell.lines:
        if body_index_of_side(scene, line) != body:
            continue
        wall = None if walls is None else walls.wall_of(line.name)
        (x, y), end = line.ends(0.0, top)
        marks = [0.0, float(np.hypot(end[0] - x, end[1] - y))]
        if wall is not None and wall.length is not None:
            marks[1] = min(marks[1], wall.length)
        if wall is not None and wall.gap_start is not None and wall.gap_end is not None:
            marks[1:1] = wall.gap_start, wall.gap_end
        points = [(x + s * line.tangent[0], y + s * line.tangent[1]) for s in marks]
        for start, stop in zip(points[::2], points[1::2], strict=True):
            yield SidePiece(line, wall is not None, start, stop)


def draw_bed(
    axes: Axes, scene: Scene, positions: Float[np.ndarray, "n 2"], heights: Float[np.ndarray, "p"]
) -> None:
    """Draw the grains, the cell, the piston and further pistons to scale; positions and heights [m]."""
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
    top = float(positions[:, 1].max()) if scene.piston is None else heights[0]
    for body, height in enumerate([0.0, *heights]):
        style: Any = {"color": "#333333", "lw": 1.5} if body == CELL else {"color": COLOURS[1], "lw": 3.0}
        for piece in side_pieces(scene, body, top) if body != PISTON or scene.piston is not None else ():
            x, y = 1e3 * np.transpose([piece.start, piece.end])
            axes.plot(x, y + 1e3 * height, **style)
    set_equal_scale_in_millimetres(axes)
    axes.set_xlim(-0.01 * width, 1.01 * width)
    axes.set_ylim(-0.01 * width, 1e3 * top + 0.02 * width)


def set_equal_scale_in_millimetres(ax: Axes) -> Axes:
    """Set equal scales on both axes, labels in millimetres and no grid."""
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.grid(visible=False)
    ax.set(xlabel="x [mm]", ylabel="y [mm]")
    return ax
