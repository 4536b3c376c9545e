"""A bed to scale in axes of Matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.shared.plotting import COLOURS

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes

    from granular.scene.scene import Scene


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
    top = 1e3 * (piston_height if piston_height is not None else float(positions[:, 1].max()))
    axes.plot([0.0, 0.0, width, width], [top, 0.0, 0.0, top], color="#333333", linewidth=1.5)
    if piston_height is not None:
        axes.plot([0.0, width], [top, top], color=COLOURS[1], linewidth=3.0)
    style_as_map(axes)
    axes.set_xlim(-0.01 * width, 1.01 * width)
    axes.set_ylim(-0.01 * width, top + 0.02 * width)


def style_as_map(ax: Axes) -> Axes:
    """Draw axes to scale, without a grid, in millimetres."""
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.grid(visible=False)
    ax.set(xlabel="x [mm]", ylabel="y [mm]")
    return ax
