"""Plots of the observables; each function draws on given axes or in a new figure.

Matplotlib is imported on first use. Save a plot with ``ax.figure.savefig("file.png")``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.defects import Dislocations
from granular.observables.forces import piston_force
from granular.observables.statistics import BiexponentialFit, Histogram
from granular.observables.voronoi import VoronoiCells, cell_polygons, voronoi_cells
from granular.scene.bed_drawing import set_equal_scale_in_millimetres
from granular.shared.plotting import ARROWS_TO_SCALE, COLOURS, GREY, SIDES, STYLES, axes_or_new, figure_label

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

    from granular.run.trajectory import Trajectory

__all__ = [
    "plot_area_profile",
    "plot_biexponential",
    "plot_cells",
    "plot_correlation_function",
    "plot_defect_paths",
    "plot_dislocations",
    "plot_force_distribution",
    "plot_forces",
    "plot_hysteresis",
    "plot_order_correlation",
    "plot_response",
    "plot_series",
]

_PATHS = (COLOURS[0], COLOURS[1], COLOURS[2], COLOURS[5], COLOURS[6])
"""Colours of defect paths, all different from the colours of the cells underneath."""


def plot_cells(cells: VoronoiCells, positions: np.ndarray, ax: Axes | None = None) -> Axes:
    """Draw the interior Voronoi cells, coloured by their number of sides, and the grains' centres.

    The colours are the same as in ``granular render --colour sides``. De Paula used green and red, which some
    readers cannot distinguish.

    Parameters
    ----------
    cells : VoronoiCells
        Voronoi cells of the positions.
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    ax = axes_or_new(ax, 7.2, 4.2)
    polygons = cell_polygons(cells)
    classes, colours = np.clip(cells.sides, 4, 8) - 4, tuple(SIDES.values())
    ax.add_collection(
        PolyCollection(
            [1e3 * polygon for polygon in polygons.values()],
            facecolors=[colours[classes[i]] for i in polygons],
            edgecolors="white",
            linewidths=0.6,
        )
    )
    ax.plot(*(1e3 * np.asarray(positions)).T, ".", color="#333333", markersize=2.0)
    present = {int(classes[i]) for i in polygons}
    patches = [
        Patch(facecolor=colour, edgecolor="#333333", linewidth=0.4, label=name)
        for k, (name, colour) in enumerate(SIDES.items())
        if k in present
    ]
    ax.legend(
        handles=patches,
        title="sides of the cell",
        loc="upper left",
        alignment="left",
        bbox_to_anchor=(1.0, 1.0),
    )
    return set_equal_scale_in_millimetres(ax)


def plot_dislocations(dislocations: Dislocations, positions: np.ndarray, ax: Axes | None = None) -> Axes:
    """Draw the grains, the pentagon and the heptagon of each dislocation, and its Burgers vector.

    Parameters
    ----------
    dislocations : Dislocations
        Dislocations of these positions.
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax, 7.2, 4.2)
    points = 1e3 * np.asarray(positions)
    ax.plot(*points.T, ".", color=GREY, markersize=3.0)
    for column, (colour, marker, label) in enumerate(
        [(COLOURS[0], "p", "five neighbours"), (COLOURS[1], "o", "seven neighbours")]
    ):
        chosen = points[dislocations.pairs[:, column]]
        ax.plot(*chosen.T, marker, color=colour, markersize=5.0, linestyle="none", label=label)
    if len(dislocations.pairs):
        ax.quiver(
            *(1e3 * dislocations.positions).T, *(1e3 * dislocations.burgers).T, **ARROWS_TO_SCALE, width=0.003
        )
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return set_equal_scale_in_millimetres(ax)


def plot_defect_paths(tracked: xarray.Dataset, positions: np.ndarray, ax: Axes | None = None) -> Axes:
    """Draw the paths of defects and their Burgers vectors over the Voronoi cells of a frame.

    Parameters
    ----------
    tracked : xarray.Dataset
        Tracks, as returned by `track_defects`.
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patheffects import withStroke

    positions = np.asarray(positions, dtype=np.float64)
    ax = plot_cells(voronoi_cells(positions), positions, ax)
    border = [withStroke(linewidth=3.2, foreground="white")]
    kinds = list(tracked["defect"].values)
    shown = set()
    for track in range(tracked.sizes["track"]):
        path = 1e3 * tracked["position"].values[:, track]
        path = path[np.isfinite(path).all(axis=1)]
        kind = str(tracked["kind"].values[track])
        colour = _PATHS[kinds.index(kind) % len(_PATHS)]
        label = None if kind in shown else kind
        shown.add(kind)
        ax.plot(*path.T, color=colour, linewidth=1.6, label=label, path_effects=border)
        ax.plot(*path[0], "o", color=colour, markersize=5.0, markerfacecolor="white")
        ax.plot(*path[-1], "x", color=colour, markersize=5.0, path_effects=border)
        arrow = 1e3 * tracked["burgers"].values[track]
        if kind == "dislocation":
            ax.quiver(*path[-1], *arrow, **ARROWS_TO_SCALE, width=0.004, zorder=4)
    if shown:
        legend_style: dict[str, Any] = {"color": "#333333", "linestyle": "none", "markersize": 6.0}
        markers = [("o", "first detected"), ("x", "last detected"), (r"$\rightarrow$", "Burgers vector")]
        sides, handles = ax.get_legend(), ax.get_legend_handles_labels()[0]
        handles += [
            Line2D([], [], marker=marker, label=name, markerfacecolor="white", **legend_style)
            for marker, name in (markers if "dislocation" in shown else markers[:2])
        ]
        ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        if sides is not None:
            sides.set_clip_on(False)  # the legend is next to the axes
            ax.add_artist(sides)
    return set_equal_scale_in_millimetres(ax)


def plot_series(series: xarray.DataArray, ax: Axes | None = None) -> Axes:
    """Draw an observable against ``frame`` or ``time``, with one line for each value of a second dimension.

    Parameters
    ----------
    series : xarray.DataArray
        Observable, as returned by `per_frame`.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    along = "time" if "time" in series.dims else "frame"
    time = series["time" if along == "time" else "frame_time"]
    others = [dim for dim in series.dims if dim != along]
    if others:
        for k, label in enumerate(series[others[0]].values):
            line = series.isel({others[0]: k})
            ax.plot(time, line, STYLES[k % len(STYLES)], label=figure_label(label))
        ax.legend()
    else:
        ax.plot(time, series)
    ax.set(xlabel="time [s]", ylabel=_axis_label(series))
    return ax


def plot_hysteresis(run: Trajectory, ax: Axes | None = None) -> Axes:
    """Draw the piston force against the piston's height, for compression and expansion [D, Fig. 3.4].

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.

    Raises
    ------
    InputError
        If no force acts on the piston.
    """
    ax = axes_or_new(ax)
    height, force = 1e3 * run.dataset["piston_height"].values, piston_force(run).values
    moving = np.gradient(height)
    for label, chosen, style in (("down", moving < 0.0, "-"), ("up", moving > 0.0, "--")):
        ax.plot(np.where(chosen, height, np.nan), np.where(chosen, force, np.nan), style, label=label)
    ax.set(xlabel="piston height [mm]", ylabel="piston force [N]")
    ax.legend()
    return ax


def plot_area_profile(profile: xarray.DataArray, ax: Axes | None = None) -> Axes:
    """Draw the local area fraction of one or more frames against the depth below the piston [D, Fig. 3.2].

    Parameters
    ----------
    profile : xarray.DataArray
        Area fraction on ``depth`` [m], as returned by `area_fraction_by_depth`.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    frames = profile if "frame" in profile.dims else profile.expand_dims("frame")
    for k in range(frames.sizes["frame"]):
        part = frames.isel(frame=k)
        label = f"{float(part['frame_time']):.3g} s" if "frame_time" in part.coords else None
        ax.plot(1e3 * part["depth"], part, STYLES[k % len(STYLES)], marker=".", label=label)
    ax.set(xlabel="depth below the piston [mm]", ylabel="local area fraction")
    ax.legend(title="time")
    return ax


def plot_correlation_function(function: xarray.DataArray, ax: Axes | None = None) -> Axes:
    """Draw a correlation function of a run, such as g(r) or g6(r), against distance.

    Parameters
    ----------
    function : xarray.DataArray
        Correlation on ``distance`` [m], as returned by `per_distance`.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    ax.plot(1e3 * function["distance"], function)
    ax.set(xlabel="distance [mm]", ylabel=_axis_label(function))
    return ax


def plot_force_distribution(histograms: dict[str, Histogram], ax: Axes | None = None) -> Axes:
    """Draw the probability density of the force on the grains, by species [D, Fig. 4.21].

    Parameters
    ----------
    histograms : mapping of str to Histogram
        Histogram of the forces [N] of each species.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    for k, (name, histogram) in enumerate(histograms.items()):
        ax.stairs(
            histogram.density,
            histogram.edges,
            fill=True,
            alpha=0.35,
            color=COLOURS[k % len(COLOURS)],
            label=f"{figure_label(name)}: {histogram.counts.sum()} grains",
        )
    ax.set(xlabel="compressive force on the grain [N]", ylabel="probability density [1/N]")
    ax.legend()
    return ax


def plot_forces(
    positions: np.ndarray, forces: np.ndarray, species: np.ndarray, ax: Axes | None = None
) -> Axes:
    """Draw the resultant force on each grain as an arrow [D, Fig. 4.23].

    Each species has one colour, and its arrows are scaled by its maximum force. Grains whose force is NaN
    have no arrow.

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    forces : float64 (n, 2)
        Force on each grain [N].
    species : int (n,)
        Index of each grain's species.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax, 7.2, 4.2)
    points, forces = 1e3 * np.asarray(positions), np.asarray(forces, dtype=np.float64)
    sizes = np.linalg.norm(forces, axis=1)
    ax.plot(*points.T, ".", color=GREY, markersize=2.0)
    for k in np.unique(species):
        chosen = (np.asarray(species) == k) & np.isfinite(sizes)
        if chosen.any() and sizes[chosen].max() > 0.0:
            ax.quiver(
                *points[chosen].T,
                *(forces[chosen] / sizes[chosen].max()).T,
                color=COLOURS[int(k) % len(COLOURS)],
                angles="xy",
                width=0.0025,
                scale=25.0,
            )
    return set_equal_scale_in_millimetres(ax)


def plot_order_correlation(orders: np.ndarray, fractions: np.ndarray, ax: Axes | None = None) -> Axes:
    """Draw Psi6 against the fraction of hexagons, with the line of best fit [D, Fig. 4.13].

    Parameters
    ----------
    orders : float64 (k,)
        Psi6 of each bed, dimensionless.
    fractions : float64 (k,)
        Fraction of hexagons of each bed, dimensionless.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax, 4.2, 3.4)
    orders, fractions = np.asarray(orders), np.asarray(fractions)
    known = np.isfinite(orders) & np.isfinite(fractions)
    ax.plot(fractions[known], orders[known], "o", markersize=3.5)
    if np.ptp(fractions[known]) > 0.0:
        ends = np.array([fractions[known].min(), fractions[known].max()])
        ax.plot(ends, np.polyval(np.polyfit(fractions[known], orders[known], 1), ends), "--")
    ax.set(xlabel="fraction of hexagons n6", ylabel="Psi6")
    return ax


def plot_biexponential(fit: BiexponentialFit, x: np.ndarray, y: np.ndarray, ax: Axes | None = None) -> Axes:
    """Draw the samples and the fitted law A exp(l1 x) + B exp(l2 x) [D, Fig. 4.8].

    Parameters
    ----------
    fit : BiexponentialFit
        Fitted law.
    x : float64 (k,)
        Abscissae of the samples, in the units used for the fit.
    y : float64 (k,)
        Ordinates of the samples, in the units used for the fit.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    ax.plot(x, y, "o", markersize=4.0, label="samples")
    fine = np.linspace(np.min(x), np.max(x), 200)
    ax.plot(fine, fit.values(fine), label="A exp(l1 x) + B exp(l2 x)")
    ax.set(xlabel="x", ylabel="y")
    ax.legend()
    return ax


def plot_response(responses: list[xarray.Dataset], ax: Axes | None = None) -> Axes:
    """Draw the amplitude ratio of each harmonic, with error bars, against the drive frequency.

    Parameters
    ----------
    responses : list of xarray.Dataset
        Responses, as returned by `stage_response`.
    ax : Axes, optional
        Axes to draw on; if not given, a new figure is made.

    Returns
    -------
    Axes
        Axes with the plot.
    """
    ax = axes_or_new(ax)
    frequencies = [response.attrs["frequency"] for response in responses]
    for k, harmonic in enumerate(responses[0]["harmonic"].values):
        ratio, error = (
            [float(response[name].sel(harmonic=harmonic)) for response in responses]
            for name in ("ratio", "ratio_error")
        )
        ax.errorbar(
            frequencies,
            ratio,
            error,
            fmt="o" + STYLES[k % len(STYLES)],
            markersize=4.0,
            capsize=2.0,
            label=f"harmonic {harmonic}",
        )
    ax.set_yscale("log")
    unit = responses[0]["ratio"].attrs["units"]
    ax.set(xlabel="frequency of the drive [Hz]", ylabel=f"amplitude ratio [{unit}]")
    ax.legend()
    return ax


def _axis_label(array: xarray.DataArray) -> str:
    unit, name = array.attrs.get("units", "1"), str(array.attrs.get("long_name", ""))
    return name if unit == "1" else f"{name} [{unit}]"
