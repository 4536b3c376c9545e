"""A picture of the bed, drawn once and then updated from frame to frame.

The colourings are defined in one table. Continuous colours are matplotlib's perceptually uniform maps.
Discrete colours are also distinguishable for colour-blind readers: the species use the palette of Okabe and
Ito (https://jfly.uni-koeln.de/color/), the numbers of sides range from orange to purple.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.export.frames import load_run_if_path
from granular.observables.catalogue import grain_compressive_force, grain_pressure, interior_force_fluctuation
from granular.observables.forces import interaction_forces
from granular.observables.frame import Frame, frame_at, present_grain_mask
from granular.observables.voronoi import cell_polygons, hexagon_regularity, voronoi_cells
from granular.run.trajectory import Trajectory
from granular.scene.bed_drawing import SidePiece, body_index_of_side, side_pieces
from granular.scene.scene import Scene
from granular.schema.cell import CELL, ROUNDING, Point
from granular.schema.cell import PISTON as PISTON_BODY
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote, unknown_word_message
from granular.shared.files import write_atomically
from granular.shared.plotting import COLOURS, GREY, SIDES, figure_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SPECIES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442")


class Colouring(NamedTuple):
    """A quantity that is shown by colours, with its colour scale."""

    label: str  # title of the colour bar or legend, with unit
    values: Callable[[Frame], np.ndarray]  # (n,), in that unit, or class indices; NaN if undefined
    map: str = ""  # matplotlib colour map; empty for classes
    needs_cells: bool = False  # values come from the Voronoi cells, which are drawn
    on_cells: bool = False  # cells are coloured and grains are dark discs
    lower: float | None = 0.0  # lower end of the colour scale; None for the 1st percentile
    upper: float | None = None  # upper end; None for the 99th percentile


def _voronoi_side_counts(frame: Frame) -> np.ndarray:
    cells = voronoi_cells(frame.positions)
    return np.where(cells.interior, np.clip(cells.sides, 4, 8) - 4.0, np.nan)


COLOURINGS: Mapping[str, Colouring] = {
    "species": Colouring("species", lambda frame: frame.species.astype(float)),
    "speed": Colouring(
        "speed [mm/s]", lambda frame: 1e3 * np.linalg.norm(frame.velocities, axis=1), "viridis"
    ),
    "force": Colouring(
        "force of grains and walls [N]",
        lambda frame: np.linalg.norm(interaction_forces(frame), axis=1),
        "inferno",
    ),
    "compression": Colouring("compressive force [N]", grain_compressive_force, "inferno", lower=None),
    "pressure": Colouring(
        "pressure of the grain [N/m] (white: rim)",
        grain_pressure,
        "inferno",
        needs_cells=True,
        on_cells=True,
        lower=None,
    ),
    "sides": Colouring("sides of the Voronoi cell", _voronoi_side_counts, needs_cells=True, on_cells=True),
    "regularity": Colouring(
        "regularity of the hexagons (white: others)",
        lambda frame: hexagon_regularity(voronoi_cells(frame.positions)),
        "viridis",
        needs_cells=True,
        on_cells=True,
        lower=None,
        upper=1.0,
    ),
    "fluctuation": Colouring(
        "relative fluctuation of the force (white: rim)",
        interior_force_fluctuation,
        "cividis",
        needs_cells=True,
    ),
}
"""Colourings by name.

- ``species``; ``speed``
- ``force``: magnitude of the resultant force of grains and walls
- ``compression``: sum of the magnitudes of the individual forces of grains and walls
- ``pressure``: from the virial, for grains with an interior cell
- ``sides``: number of sides of the interior Voronoi cells
- ``regularity`` of the hexagonal cells [D, eq. 4.25]
- ``fluctuation``: |F_k - mean|/mean of the resultant force within the species, for grains with an interior
  cell [D, eq. 4.35]

A cell is interior if it lies within the bounding box of the centres [D, 4.2.4].
"""


def colouring_by_name(name: str) -> Colouring:
    """Find a colouring by its name."""
    if name not in COLOURINGS:
        raise InputError(unknown_word_message(name, tuple(COLOURINGS), "colour"))
    return COLOURINGS[name]


def colour_classes(name: str, scene: Scene) -> dict[str, str]:
    """Return the colours of a discrete colouring's classes by name; empty for a continuous colouring."""
    if name == "sides":
        return SIDES
    if name != "species":
        return {}
    names = [f"{specy.name}, {1e3 * specy.diameter:g} mm" for specy in scene.grains.species]
    return {name: SPECIES[k % len(SPECIES)] for k, name in enumerate(names)}


INK, WALL = "#22292f", "#8a949c"
DPI = 120
"""Pixels per inch in movies."""

FALL = 5.0
"""Space shown below an opening, through which grains fall out [D]."""

WIDEST, TALLEST = 5.6, 6.6
"""Maximum width and height of the bed in a picture [inch]."""

LEFT, RIGHT, BOTTOM, TOP = 0.65, 1.75, 0.55, 0.4
"""Margins around the bed for labels, legend and title [inch]."""


def wall_thickness_mm(scene: Scene) -> float:
    """Return the thickness [mm] of the drawn walls and piston, proportional to the cell's width."""
    return 0.018 * 1e3 * scene.cell.width


CURVE = 1.5
"""Height of the plot below the bed in a movie, with its labels [inch]."""


def new_figure_and_axes_to_scale(
    scene: Scene, top: float, below: float = 0.0, widest: float = WIDEST
) -> tuple[Figure, Axes, Axes]:
    """Make axes [mm] for a bed to scale, and axes to their right; ``top`` in m, other lengths in inches."""
    from matplotlib.figure import Figure

    edge, walls = 1.5 * wall_thickness_mm(scene), scene.effects.walls
    fall = 0.0 if walls is None or not walls.has_gap else FALL * 1e3 * scene.grains.species[0].diameter
    width, height = 1e3 * scene.cell.width + 2.0 * edge, 1e3 * top + fall + 2.0 * edge
    inch = min(widest / width, TALLEST / height)
    size = [
        # H.264 requires even numbers of pixels.
        2.0 * round((start + length * inch + end) * DPI / 2.0) / DPI
        for start, length, end in ((LEFT, width, RIGHT), (BOTTOM + below, height, TOP))
    ]
    figure = Figure(figsize=(size[0], size[1]), dpi=DPI, facecolor="white")
    low = (BOTTOM + below) / size[1]
    bed = (LEFT / size[0], low, width * inch / size[0], height * inch / size[1])
    axes = figure.add_axes(bed)
    axes.set_xlim(-edge, width - edge)
    axes.set_ylim(-edge - fall, height - edge - fall)
    axes.set_aspect("equal", anchor="SW")
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    axes.spines[["top", "right", "left", "bottom"]].set_visible(False)
    axes.tick_params(length=2.5, width=0.6, color=WALL)
    side = figure.add_axes((bed[0] + bed[2] + 0.15 / size[0], bed[1], 1.5 / size[0], bed[3]))
    return figure, axes, side


def draw_walls(axes: Axes, scene: Scene, top: float) -> None:
    """Draw walls up to ``top`` [m] as slabs outside the cell, and sides without a wall as dotted lines."""
    from matplotlib.patches import Polygon

    pieces, thickness = list(side_pieces(scene, CELL, top)), wall_thickness_mm(scene)
    for piece in pieces:
        if piece.walled:
            outside = [_outer_corner(piece, end, pieces, thickness) for end in (piece.end, piece.start)]
            corners = [*(1e3 * np.array([piece.start, piece.end])), *outside]
            axes.add_patch(Polygon(corners, color=WALL, linewidth=0.0))
        else:
            x, y = 1e3 * np.transpose([piece.start, piece.end])
            axes.plot(x, y, ":", color=WALL, linewidth=1.0, zorder=0)
    if scene.cell.periods is not None:
        axes.plot([0.0, 1e3 * scene.cell.width], [1e3 * top] * 2, ":", color=WALL, linewidth=1.0, zorder=0)


def _outer_corner(
    piece: SidePiece, end: Point, pieces: list[SidePiece], thickness: float
) -> Float[np.ndarray, "2"]:
    """Return the outer corner [mm] of a drawn wall at one end, on the mitre with an adjacent wall."""
    normal, normals = np.array(piece.line.normal), [np.array(piece.line.normal)]
    for other in pieces:
        meets = min(math.dist(end, other.start), math.dist(end, other.end)) < ROUNDING
        if other.walled and meets and other.line is not piece.line:
            normals.append(np.array(other.line.normal))
    normal_sum = np.sum(normals, axis=0)
    return 1e3 * np.array(end) - thickness * normal_sum / (normal_sum @ normal)


MAXIMUM_CURVE_POINTS = 4000
"""Maximum number of points of the height curve; the curve has fewer pixels in width."""


class PistonHeightCurve:
    """Curve of the piston's height over the complete movie, with the part already shown highlighted."""

    def __init__(self, run: Trajectory, start: float, end: float, axes: Axes) -> None:
        data = run.dataset
        time = data["time"].values
        chosen = np.flatnonzero((time >= start) & (time <= end))
        chosen = chosen[:: max(1, len(chosen) // MAXIMUM_CURVE_POINTS)]
        self._time = time[chosen]
        self._height = 1e3 * data["piston_height"].values[chosen]
        axes.plot(self._time, self._height, color=GREY, linewidth=0.8)
        (self._past,) = axes.plot([], [], color=COLOURS[0], linewidth=1.6)
        (self._now,) = axes.plot([], [], "o", color=COLOURS[1], markersize=4.5)
        axes.set_xlim(start, end if end > start else start + 1.0)
        axes.set(xlabel="time [s]", ylabel="piston [mm]")
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(length=2.5, width=0.6, color=INK)

    def show_until(self, time: float) -> None:
        """Mark the curve up to a time [s], and the piston's height at that time."""
        past = self._time <= time
        self._past.set_data(self._time[past], self._height[past])
        if past.any():
            self._now.set_data(self._time[past][-1:], self._height[past][-1:])


LONGEST_BAR = 3.0
"""Maximum length of the colour bar [inch]."""

PISTON, ABSENT, DISC = "#3d4852", "#ffffff", "#2f3a44"
COLOUR_PERCENTILES = (1.0, 99.0)
"""Percentiles at the ends of the colour scale; a few extreme values therefore do not compress the scale."""


class BedPicture:
    """A figure of the bed that shows successive frames."""

    def __init__(
        self,
        run: Trajectory,
        colour: str,
        limits: tuple[float, float],
        top: float,
        duration: tuple[float, float] | None = None,
        widest: float = WIDEST,
    ) -> None:
        import matplotlib as mpl

        self.run, self.colour = run, colouring_by_name(colour)
        self._classes = colour_classes(colour, run.scene)
        self._times = run.dataset["time"].values
        self._forces = run.dataset["piston_force"].values if "piston_force" in run.dataset else None
        with mpl.rc_context({"font.size": 9.0, "font.family": "DejaVu Sans"}):
            below = CURVE if duration is not None and "piston_height" in run.dataset else 0.0
            self.figure, self._axes, side = new_figure_and_axes_to_scale(run.scene, top, below, widest)
            self._curve = None
            if duration is not None and below:
                bed, tall = self._axes.get_position(), self.figure.get_figheight()
                space = (bed.x0, BOTTOM / tall, bed.width, (CURVE - 0.55) / tall)
                self._curve = PistonHeightCurve(run, *duration, self.figure.add_axes(space))
            draw_walls(self._axes, run.scene, top)
            self._draw_moving_parts()
            if self._classes:
                self._draw_legend(side)
            else:
                self._draw_colour_bar(side, limits)

    def _draw_moving_parts(self) -> None:
        from matplotlib.collections import EllipseCollection, PolyCollection
        from matplotlib.patches import Polygon

        axes = self._axes
        self._cells: Any = PolyCollection([], edgecolors="white", linewidths=0.7, zorder=1)
        axes.add_collection(self._cells)
        none = np.empty(0)
        self._grains: Any = EllipseCollection(
            none,
            none,
            none,
            units="xy",
            offsets=np.empty((0, 2)),
            offset_transform=axes.transData,
            linewidths=0.35,
            edgecolors=INK,
            zorder=2,
        )
        axes.add_collection(self._grains)
        scene = self.run.scene
        self._pistons: list[tuple[Any, np.ndarray, int]] = []
        for line in scene.cell.lines:
            body = body_index_of_side(scene, line)
            if body == CELL or (body == PISTON_BODY and scene.piston is None):
                continue
            start, end = line.ends(0.0, 0.0)
            outwards = -wall_thickness_mm(scene) * np.array(line.normal)
            inner = 1e3 * np.array([start, end])
            shape = np.concatenate([inner, inner[::-1] + outwards])
            patch = axes.add_patch(Polygon(shape, color=PISTON, zorder=3))
            self._pistons.append((patch, shape, body - PISTON_BODY))
        title: Any = {"transform": axes.transAxes, "va": "bottom", "color": INK}
        self._when = axes.text(0.0, 1.015, "", ha="left", fontweight="bold", **title)
        self._where = axes.text(1.0, 1.015, "", ha="right", **title)

    def _draw_legend(self, side: Axes) -> None:
        from matplotlib.patches import Patch

        handles = [
            Patch(facecolor=colour, edgecolor=INK, linewidth=0.5, label=figure_label(name))
            for name, colour in self._classes.items()
        ]
        if self.colour.needs_cells:
            handles.append(Patch(facecolor=ABSENT, edgecolor=INK, linewidth=0.5, label="at the rim"))
        side.axis("off")
        side.legend(
            handles=handles,
            title=self.colour.label.replace(" of the ", "\nof the "),
            loc="upper left",
            bbox_to_anchor=(0.0, 1.0),
            borderaxespad=0.0,
            frameon=False,
            alignment="left",
            handlelength=1.1,
            handleheight=1.1,
        )

    def _draw_colour_bar(self, side: Axes, limits: tuple[float, float]) -> None:
        import matplotlib as mpl
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        scale = ScalarMappable(Normalize(*limits), mpl.colormaps[self.colour.map])
        self._scale = scale
        low, high = self.colour.lower is None, self.colour.upper is None
        ends = {(True, True): "both", (True, False): "min", (False, True): "max"}
        side.axis("off")
        tall = side.get_position().height * self.figure.get_figheight()
        fraction = min(1.0, LONGEST_BAR / tall)
        bar = self.figure.colorbar(
            scale,
            cax=side.inset_axes((0.0, 0.5 - fraction / 2.0, 0.11, fraction)),
            extend=ends.get((low, high), "neither"),
            extendfrac=0.1 / (fraction * tall),
        )
        bar.set_label(self.colour.label)
        bar.outline.set_linewidth(0.6)

    def show_frame(self, frame: Frame) -> None:
        """Update grains, cells, piston and title to a frame."""
        from matplotlib.colors import to_rgba

        present = present_grain_mask(frame.positions)
        diameters = 1e3 * frame.diameters[present]
        self._grains.set_offsets(1e3 * frame.positions[present])
        self._grains.set_widths(diameters)
        self._grains.set_heights(diameters)
        self._grains.set_angles(np.zeros(len(diameters)))
        colours = self._map_to_colours(self.colour.values(frame))
        if self.colour.needs_cells:
            cells = voronoi_cells(frame.positions)
            polygons = cell_polygons(cells)
            self._cells.set_verts([1e3 * corners for corners in polygons.values()])
            inner = list(polygons)
            on_cells = self.colour.on_cells
            self._cells.set_facecolor(colours[inner] if on_cells and inner else "none")
            self._cells.set_edgecolor("#ffffff" if on_cells else "#c3c9ce")
            if on_cells:
                colours = np.where(cells.interior[:, None], to_rgba(DISC), to_rgba(ABSENT))
        self._grains.set_facecolor(colours[present])
        self._when.set_text(f"t = {frame.time:.3f} s" + figure_label(self._stage_label_at(frame.time)))
        self._where.set_text(self._piston_text(frame))
        for patch, shape, index in self._pistons:
            patch.set_xy(shape + np.array([0.0, 1e3 * frame.heights[index]]))
        if self._curve is not None:
            self._curve.show_until(frame.time)

    def pixels(self) -> np.ndarray:
        """Draw the picture; return its pixels, uint8 (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas: Any = FigureCanvasAgg(self.figure)
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])

    def _map_to_colours(self, values: np.ndarray) -> np.ndarray:
        """Return colours (k, 4) for values (k,)."""
        from matplotlib.colors import to_rgba

        known = np.isfinite(values)
        colours = np.tile(to_rgba(ABSENT), (len(values), 1))
        if self._classes:
            palette = np.array([to_rgba(colour) for colour in self._classes.values()])
            colours[known] = palette[values[known].astype(int)]
        else:
            colours[known] = self._scale.to_rgba(values[known])
        return colours

    def _stage_label_at(self, time: float) -> str:
        for stage in self.run.stages:
            if stage.start <= time <= stage.end and stage.end > stage.start:
                return f"   {stage.name}"
        return ""

    def _piston_text(self, frame: Frame) -> str:
        if frame.scene.piston is None:
            return ""
        words = f"piston at {1e3 * frame.piston_height:.1f} mm"
        if self._forces is not None:
            record = min(int(np.searchsorted(self._times, frame.time)), len(self._times) - 1)
            words += f"   force {self._forces[record]:.2f} N"
        return words


def choose_colour_limits(colour: str, frames: Iterable[Frame]) -> tuple[float, float]:
    """Choose the ends of a continuous colour scale: fixed values, or percentiles over the given frames."""
    used = colouring_by_name(colour)
    if not used.map:
        return 0.0, 1.0
    result = [used.values(frame) for frame in frames]
    values = np.concatenate(result) if result else np.empty(0)
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, COLOUR_PERCENTILES) if len(values) else (0.0, 1.0)
    low = low if used.lower is None else used.lower
    high = high if used.upper is None else used.upper
    return (float(low), float(high)) if high > low else (float(low), float(low) + 1.0)


def highest_point_of_bed(run: Trajectory, frames: Iterable[Frame]) -> float:
    """Return the height [m] of a periodic cell, or else the maximum height of piston and grains."""
    if run.scene.cell.height is not None:
        return run.scene.cell.height
    radius = run.scene.grains.diameters().max(initial=0.0) / 2.0
    top = 0.0
    for frame in frames:
        reach = np.fmax.reduce(frame.positions[:, 1], initial=0.0) + radius
        top = max(top, reach, float(np.fmax(frame.piston_height, 0.0)))
    return top or run.scene.cell.width


FORMATS = (".png", ".svg", ".pdf")
STILL_DPI = 200


def still(
    run: Trajectory | str | Path, frame: int = -1, *, time: float | None = None, colour: str = "species"
) -> Figure:
    """Draw the bed at one instant, with grains to scale, walls and piston.

    Grains that have left the cell are not drawn.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    frame : int
        Index of the frame, from 0; negative indices count from the end.
    time : float, optional
        Use the frame nearest to this time [s] instead.
    colour : str
        Quantity shown by the colours: a name in `granular.render.picture.COLOURINGS`. The colour scale ends
        at the 99th percentile of the frame's values.

    Returns
    -------
    matplotlib Figure
        Picture, to be written by `save_picture`.

    Raises
    ------
    InputError
        If the run cannot be read, has no such frame, does not reach the time, or the colour is unknown.
    """
    colouring_by_name(colour)
    run = load_run_if_path(run)
    chosen = frame_at(run, frame if time is None else _nearest_frame_index(run, time))
    picture = BedPicture(
        run, colour, choose_colour_limits(colour, [chosen]), highest_point_of_bed(run, [chosen])
    )
    picture.show_frame(chosen)
    return picture.figure


def _nearest_frame_index(run: Trajectory, time: float) -> int:
    times = run.dataset["frame_time"].values
    if not (math.isfinite(time) and times[0] <= time <= times[-1]):
        raise InputError(
            f"time {time:g} s is outside the run; give a time from {times[0]:g} to {times[-1]:g} s"
        )
    return int(np.abs(times - time).argmin())


def save_picture(figure: Figure, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a picture as PNG (200 dots per inch), SVG or PDF, depending on the suffix of the path.

    The file contains no date, so that equal pictures give equal files.

    Parameters
    ----------
    figure : Figure
        Picture, as returned by `still`.
    path : str or Path
        Path of the file to write.
    overwrite : bool
        Whether an existing file may be replaced.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        If the format is unknown, the file exists and may not be replaced, or it cannot be written.
    """
    import matplotlib as mpl

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            f"unknown format {quote(path.suffix)} of {path.name}; the path of a still must end in "
            f"{', '.join(FORMATS)}, the path of a movie in .mp4 or .gif"
        )
    # Without dates and random names, equal pictures give equal files.
    undated = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with write_atomically(path, overwrite) as part, mpl.rc_context({"svg.hashsalt": "granular"}):
        figure.savefig(part, dpi=STILL_DPI, metadata=undated[path.suffix.lower()])
    return path
