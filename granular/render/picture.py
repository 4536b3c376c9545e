"""A picture of the bed: drawn once, then brought up to date from frame to frame."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.export.frames import BedFrame
from granular.observables.voronoi import cell_polygons, voronoi_cells
from granular.render.colourings import View, classes, colouring
from granular.render.curve import PistonCurve
from granular.render.page import (
    CURVE,
    INK,
    WIDEST,
    axes_below,
    draw_walls,
    new_page,
    wall_thickness,
)
from granular.run.trajectory import Trajectory
from granular.shared.plotting import plain_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST_BAR = 3.0
"""Longest colour bar [inch]."""

PISTON, ABSENT, DISC = "#3d4852", "#ffffff", "#2f3a44"
ENDS = (1.0, 99.0)
"""Percentiles at which the colours end: a few fast grains shall not darken all others."""


class BedPicture:
    """A figure of the bed, for one frame after the other.

    With a span of time [s] it has the piston's height over it below the bed, which is at most
    ``widest`` wide [inch].

    Attributes
    ----------
    figure : matplotlib Figure
    """

    def __init__(
        self,
        run: Trajectory,
        colour: str,
        limits: tuple[float, float],
        top: float,
        span: tuple[float, float] | None = None,
        widest: float = WIDEST,
    ) -> None:
        import matplotlib as mpl

        self.run, self.colour = run, colouring(colour)
        self._species = run.scene.grains.assignment()
        self._diameters = 1e3 * run.scene.grains.diameters()
        self._classes = classes(colour, run.scene)
        self._times = run.dataset["time"].values
        self._forces = run.dataset["piston_force"].values if "piston_force" in run.dataset else None
        with mpl.rc_context({"font.size": 9.0, "font.family": "DejaVu Sans"}):
            curve = span is not None and "piston_height" in run.dataset
            self.figure, self._axes, side = new_page(
                run.scene, top, CURVE if curve else 0.0, widest
            )
            self._curve = None
            if span is not None and curve:
                self._curve = PistonCurve(run, *span, axes_below(self.figure, self._axes))
            draw_walls(self._axes, run.scene, top)
            self._draw_moving_parts()
            if self._classes:
                self._draw_legend(side)
            else:
                self._draw_bar(side, limits)

    def _draw_moving_parts(self) -> None:
        from matplotlib.collections import EllipseCollection, PolyCollection
        from matplotlib.patches import Rectangle

        axes = self._axes
        self._cells: Any = PolyCollection([], edgecolors="white", linewidths=0.7, zorder=1)
        axes.add_collection(self._cells)
        none = np.empty(0)
        self._grains: Any = EllipseCollection(
            none, none, none, units="xy", offsets=np.empty((0, 2)),
            offset_transform=axes.transData, linewidths=0.35, edgecolors=INK, zorder=2,
        )  # fmt: skip
        axes.add_collection(self._grains)
        thickness = wall_thickness(self.run.scene)
        width = 1e3 * self.run.scene.cell.width
        self._piston = Rectangle((0.0, 0.0), width, thickness, color=PISTON, zorder=3)
        self._piston.set_visible(self.run.scene.piston is not None)
        axes.add_patch(self._piston)
        title: Any = {"transform": axes.transAxes, "va": "bottom", "color": INK}
        self._when = axes.text(0.0, 1.015, "", ha="left", fontweight="bold", **title)
        self._where = axes.text(1.0, 1.015, "", ha="right", **title)

    def _draw_legend(self, side: Axes) -> None:
        from matplotlib.patches import Patch

        handles = [
            Patch(facecolor=colour, edgecolor=INK, linewidth=0.5, label=plain_label(name))
            for name, colour in self._classes.items()
        ]
        if self.colour.needs_cells:
            handles.append(
                Patch(facecolor=ABSENT, edgecolor=INK, linewidth=0.5, label="at the rim")
            )
        side.axis("off")
        side.legend(
            handles=handles, title=self.colour.label.replace(" of the ", "\nof the "),
            loc="upper left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.0, frameon=False,
            alignment="left", handlelength=1.1, handleheight=1.1,
        )  # fmt: skip

    def _draw_bar(self, side: Axes, limits: tuple[float, float]) -> None:
        import matplotlib as mpl
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        scale = ScalarMappable(Normalize(*limits), mpl.colormaps[self.colour.map])
        self._scale = scale
        low, high = self.colour.lower is None, self.colour.upper is None
        ends = {(True, True): "both", (True, False): "min", (False, True): "max"}
        side.axis("off")
        tall = side.get_position().height * self.figure.get_figheight()
        share = min(1.0, LONGEST_BAR / tall)
        bar = self.figure.colorbar(
            scale,
            cax=side.inset_axes((0.0, 0.5 - share / 2.0, 0.11, share)),
            extend=ends.get((low, high), "neither"),
            extendfrac=0.1 / (share * tall),
        )
        bar.set_label(self.colour.label)
        bar.outline.set_linewidth(0.6)

    def show(self, frame: BedFrame) -> None:
        """Bring the picture up to date."""
        from matplotlib.colors import to_rgba

        self._grains.set_offsets(1e3 * frame.position)
        diameters = self._diameters[frame.grains]
        self._grains.set_widths(diameters)
        self._grains.set_heights(diameters)
        self._grains.set_angles(np.zeros(len(diameters)))
        view = view_of(self.run, self.colour.needs_cells, frame)
        colours = self._colours(self.colour.values(view))
        if view.cells is not None:
            polygons = cell_polygons(view.cells)
            self._cells.set_verts([1e3 * corners for corners in polygons.values()])
            inner = list(polygons)
            on_cells = self.colour.on_cells
            self._cells.set_facecolor(colours[inner] if on_cells and inner else "none")
            self._cells.set_edgecolor("#ffffff" if on_cells else "#c3c9ce")
            if on_cells:
                colours = np.where(view.cells.interior[:, None], to_rgba(DISC), to_rgba(ABSENT))
        self._grains.set_facecolor(colours)
        self._when.set_text(f"t = {frame.time:.3f} s" + plain_label(self._stage(frame.time)))
        self._where.set_text(self._state(frame))
        if frame.height is not None:
            self._piston.set_y(1e3 * frame.height)
        if self._curve is not None:
            self._curve.show(frame.time)

    def pixels(self) -> np.ndarray:
        """The picture as bytes (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas: Any = FigureCanvasAgg(self.figure)
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])

    def _colours(self, values: np.ndarray) -> np.ndarray:
        """Colours (k, 4) of values (k,)."""
        from matplotlib.colors import to_rgba

        known = np.isfinite(values)
        colours = np.tile(to_rgba(ABSENT), (len(values), 1))
        if self._classes:
            palette = np.array([to_rgba(one) for one in self._classes.values()])
            colours[known] = palette[values[known].astype(int)]
        else:
            colours[known] = self._scale.to_rgba(values[known])
        return colours

    def _stage(self, time: float) -> str:
        for one in self.run.stages:
            if one.start <= time <= one.end and one.end > one.start:
                return f"   {one.name}"
        return ""

    def _state(self, frame: BedFrame) -> str:
        if frame.height is None:
            return ""
        words = f"piston at {1e3 * frame.height:.1f} mm"
        if self._forces is not None:
            record = min(int(np.searchsorted(self._times, frame.time)), len(self._times) - 1)
            words += f"   force {self._forces[record]:.2f} N"
        return words


def view_of(run: Trajectory, with_cells: bool, frame: BedFrame) -> View:
    """A frame as the colourings see it."""
    cells = voronoi_cells(frame.position) if with_cells else None
    return View(frame, run.scene, run.scene.grains.assignment()[frame.grains], cells)


def colour_limits(run: Trajectory, colour: str, frames: Iterable[BedFrame]) -> tuple[float, float]:
    """Ends of the colours over some frames; (0, 1) where nothing has a value."""
    one = colouring(colour)
    if not one.map:
        return 0.0, 1.0
    found = [one.values(view_of(run, one.needs_cells, frame)) for frame in frames]
    values = np.concatenate(found) if found else np.empty(0)
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, ENDS) if len(values) else (0.0, 1.0)
    low = low if one.lower is None else one.lower
    high = high if one.upper is None else one.upper
    return (float(low), float(high)) if high > low else (float(low), float(low) + 1.0)


def highest(run: Trajectory, frames: Iterable[BedFrame]) -> float:
    """Height that holds piston and grains in all the frames [m]; that of a periodic cell."""
    if run.scene.cell.height is not None:
        return run.scene.cell.height
    radius = run.scene.grains.diameters().max(initial=0.0) / 2.0
    top = 0.0
    for frame in frames:
        top = max(top, frame.height or 0.0, frame.position[:, 1].max(initial=0.0) + radius)
    return top or run.scene.cell.width
