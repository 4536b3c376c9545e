"""HTML page of a bed's small motions, and the plots on this page."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.roots import NormalModes, dynamic_stiffness, transmissibility
from granular.linear.small_motions import DRY_FRICTION, SmallMotions, slope_table_rows
from granular.scene.bed_drawing import draw_bed, set_equal_scale_in_millimetres
from granular.shared.array_types import Complex, Float, Int, Shaped
from granular.shared.blocks import Block, Caution, Heading, Picture, Printout, Table, Text, format_number
from granular.shared.html_pages import Page
from granular.shared.plotting import (
    ARROWS_TO_SCALE,
    COLOURS,
    GREY,
    READABLE,
    axes_or_new,
    figure,
    label_log_axis_plainly,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


__all__ = ["plot_density_of_states", "plot_dynamic_stiffness", "plot_mode", "plot_transmissibility"]

LONGEST_ARROW = 1.5
"""Length of the longest arrow in the plot of a mode [diameters of a grain]."""

BINS = 40


def plot_mode(rest: Equilibrium, shape: Shaped[np.ndarray, "q"], ax: Axes | None = None) -> Axes:
    """Draw the displacements of grains and piston in a mode as arrows on the bed.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of the bed.
    shape : float or complex (q,)
        Displacements of all coordinates. The real part is drawn; the longest arrow is 1.5 diameters long.
    ax : Axes, optional
        Axes to draw on; new ones if not given.

    Returns
    -------
    Axes
        Axes that hold the drawing.
    """
    ax = axes_or_new(ax)
    bed, real = rest.pencil.bed, np.real(shape)
    draw_bed(ax, rest.scene, rest.positions, rest.heights)
    ax.collections[0].set(facecolors=GREY, alpha=0.35)
    moves = bed.positions(real)
    largest = float(np.hypot(*moves.T).max())
    if bed.piston is not None:
        largest = max(largest, abs(float(real[bed.piston])))
    scale = 1e3 * LONGEST_ARROW * rest.scene.grains.species[0].diameter / largest
    ax.quiver(*(1e3 * rest.positions).T, *(scale * moves).T, **ARROWS_TO_SCALE, width=0.002)
    if bed.piston is not None:
        middle = 500.0 * rest.scene.cell.width, 1e3 * (rest.piston_height or 0.0)
        look = ARROWS_TO_SCALE | {"color": COLOURS[1]}
        ax.quiver(*middle, 0.0, scale * real[bed.piston], **look, width=0.006)
        ax.set_ylim(top=middle[1] + 1.1e3 * LONGEST_ARROW * rest.scene.grains.species[0].diameter)
    return set_equal_scale_in_millimetres(ax)


def plot_density_of_states(modes: NormalModes, ax: Axes | None = None) -> Axes:
    """Draw a histogram of the frequencies of normal modes.

    Parameters
    ----------
    modes : NormalModes
        Normal modes of a bed; unstable modes have no frequency and are not drawn.
    ax : Axes, optional
        Axes to draw on; new ones if not given.

    Returns
    -------
    Axes
        Axes that hold the drawing.
    """
    ax = axes_or_new(ax)
    frequencies = modes.frequencies[np.isfinite(modes.frequencies)]
    ax.hist(frequencies, bins=BINS, range=(0.0, float(frequencies.max(initial=1e-12))))
    ax.set(xlabel="frequency [Hz]", ylabel="number of modes")
    return ax


def plot_transmissibility(
    frequencies: Float[np.ndarray, "f"], values: Complex[np.ndarray, "f"], ax: Axes | None = None
) -> Axes:
    """Draw the modulus of a transmissibility against frequency.

    Parameters
    ----------
    frequencies : float (f,)
        Frequencies [Hz].
    values : complex (f,)
        Transmissibility, as returned by `granular.linear.transmissibility`.
    ax : Axes, optional
        Axes to draw on; new ones if not given.

    Returns
    -------
    Axes
        Axes that hold the drawing.
    """
    ax = axes_or_new(ax)
    ax.loglog(frequencies, np.abs(values))
    ax.axhline(1.0, color=GREY, linewidth=0.8)
    ax.set(xlabel="frequency [Hz]", ylabel="piston over base")
    for axis in (ax.xaxis, ax.yaxis):
        label_log_axis_plainly(axis)
    return ax


def plot_dynamic_stiffness(
    frequencies: Float[np.ndarray, "f"], values: Complex[np.ndarray, "f"], ax: Axes | None = None
) -> Axes:
    """Draw storage and loss stiffness of bed and piston against frequency.

    Parameters
    ----------
    frequencies : float (f,)
        Frequencies [Hz].
    values : complex (f,)
        Dynamic stiffness [N/m], as returned by `granular.linear.dynamic_stiffness`.
    ax : Axes, optional
        Axes to draw on; new ones if not given.

    Returns
    -------
    Axes
        Axes that hold the drawing.
    """
    ax = axes_or_new(ax)
    ax.semilogx(frequencies, 1e-3 * np.real(values), label="storage")
    ax.semilogx(frequencies, 1e-3 * np.imag(values), "--", label="loss")
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    ax.set(xlabel="frequency [Hz]", ylabel="dynamic stiffness [kN/m]")
    label_log_axis_plainly(ax.xaxis)
    ax.legend()
    return ax


POINTS, FEW_POINTS = 80, 12
"""Number of points on a curve. `FEW_POINTS` applies to large beds, where each point takes seconds."""

REACH = 4.0
"""The curves extend from the lowest frequency of a root, divided by this factor, to the highest frequency of
a root, multiplied by this factor."""

MODES = 3
LISTED = 12
"""The page shows drawings of `MODES` modes, and a table of the `LISTED` lowest modes."""


def modes_page(motions: SmallMotions) -> Page:
    """Make the page of small motions: results, drawings of modes, density of states, curves and slopes."""
    rest = motions.rest
    root, scene = motions.roots[0], rest.scene
    assert rest.piston_height is not None
    return Page(
        f"Small motions of scene {scene.name!r}",
        f"{scene.grains.count} magnets at equilibrium at {1e3 * rest.piston_height:.6g} mm: "
        f"{root.frequency:.6g} Hz without damping, damping ratio {100.0 * root.damping_ratio:.4g} %. "
        "All values are computed from the forces near the equilibrium, without a fit, and hold for small "
        "amplitudes.",
        tuple(_blocks(motions)),
        result=motions,
    )


def _blocks(motions: SmallMotions) -> Iterator[Block]:
    rest = motions.rest
    if rest.frictionless:
        yield Caution(f"{DRY_FRICTION[0].upper()}{DRY_FRICTION[1:]}.")
    if not rest.is_stable:
        yield Caution("The equilibrium is unstable: some small displacements lower the energy.")
    yield Printout(motions.figures_text)
    yield from _mode_blocks(motions)
    yield Heading("Response to a small harmonic motion")
    yield Picture(
        partial(_draw_transmissibility_and_stiffness, motions),
        "Top: displacement of the piston divided by displacement of the base, for vertical motion. Bottom: "
        "force on the piston divided by its displacement, including all inertia.",
    )
    yield Heading("Logarithmic slopes")
    yield Table(("d ln / d ln", "equilibrium", "frequency", "damping ratio"), slope_table_rows(motions))
    spread = "" if motions.deviation is None else " Means over settled beds, ± standard deviation."
    yield Text(
        "Relative change of each result per relative change of one value, with all other values and the "
        f"packing unchanged.{spread}"
    )
    yield Heading("Scene")
    yield Printout(rest.scene.to_toml())


def _mode_blocks(motions: SmallMotions) -> Iterator[Block]:
    yield Heading("Modes")
    modes = motions.modes
    largest = np.argsort(-motions.participation)[:MODES]
    yield Picture(
        partial(_draw_modes, motions, largest),
        "Displacements of grains and piston, scaled to 1.5 diameters for the longest arrow. Shown are the "
        "piston's first root (real part; the piston's arrow is in the middle) and the undamped normal modes "
        "in which the piston participates most.",
    )
    all_modes = motions.rest.pencil.has_all_modes
    part = "" if all_modes else " Only the lowest modes of this large bed are computed."
    yield Picture(
        partial(_draw_density_of_states, motions),
        f"Density of states: {len(modes.frequencies)} normal modes.{part}",
    )
    rows = sorted({*range(min(LISTED, len(modes.frequencies))), *largest.tolist()})
    yield Table(
        ("mode", "frequency [Hz]", "fraction of the piston's motion"),
        [[k + 1, format_number(modes.frequencies[k], 6), f"{motions.participation[k]:.5f}"] for k in rows],
    )


def _draw_modes(motions: SmallMotions, largest: Int[np.ndarray, "m"]) -> Figure:
    rest, modes = motions.rest, motions.modes
    shapes = [
        (f"root, {motions.roots[0].frequency:.4g} Hz", motions.roots[0].shape),
        *((f"mode {k + 1}, {modes.frequencies[k]:.4g} Hz", modes.shapes[:, k]) for k in largest),
    ]
    assert rest.piston_height is not None
    height = min(9.0, 3.6 * (rest.piston_height / rest.scene.cell.width) + 1.2)
    with figure(len(shapes), 1, height=len(shapes) * height, size=READABLE) as (drawing, panels):
        for axes, (title, shape) in zip(panels, shapes, strict=True):
            plot_mode(rest, shape, axes)
            axes.set_title(title)
        return drawing


def _draw_density_of_states(motions: SmallMotions) -> Figure:
    with figure(size=READABLE) as (drawing, axes):
        plot_density_of_states(motions.modes, axes)
        return drawing


def _draw_transmissibility_and_stiffness(motions: SmallMotions) -> Figure:
    rest, frequencies = motions.rest, curve_frequencies(motions)
    with figure(2, 1, height=6.4, size=READABLE, sharex=True) as (drawing, both):
        plot_transmissibility(frequencies, transmissibility(rest, frequencies), both[0])
        plot_dynamic_stiffness(frequencies, dynamic_stiffness(rest, frequencies), both[1])
        both[0].set_xlabel("")
        return drawing


def curve_frequencies(motions: SmallMotions) -> Float[np.ndarray, "f"]:
    """Return the frequencies [Hz] at which curves are computed, including the frequencies of the roots."""
    roots = [root.frequency for root in motions.roots]
    count = POINTS if motions.rest.pencil.has_all_modes else FEW_POINTS
    grid = np.geomspace(min(roots) / REACH, max(roots) * REACH, count)
    return np.unique(np.concatenate([grid, roots]))
