"""Pictures of small motions. Each function draws into the axes given, or into a new figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.modes import NormalModes
from granular.scene.bed_drawing import draw_bed, style_as_map
from granular.shared.plotting import ARROWS_TO_SCALE, COLOURS, GREY, axes_or_new, label_log_axis_plainly

if TYPE_CHECKING:
    from jaxtyping import Complex, Float, Shaped
    from matplotlib.axes import Axes

__all__ = ["plot_density_of_states", "plot_dynamic_stiffness", "plot_mode", "plot_transmissibility"]

LONGEST_ARROW = 1.5
"""Length of the longest arrow of a mode [diameters of a grain]."""

BINS = 40


def plot_mode(rest: Equilibrium, shape: Shaped[np.ndarray, "q"], ax: Axes | None = None) -> Axes:
    """Draw the displacements of grains and piston in a mode as arrows on the bed.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of the bed.
    shape : float or complex (q,)
        Displacements of all coordinates, of which the real part is drawn; the longest arrow is 1.5 diameters.
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
    return style_as_map(ax)


def plot_density_of_states(modes: NormalModes, ax: Axes | None = None) -> Axes:
    """Draw the number of normal modes over the frequency, in equal intervals.

    Parameters
    ----------
    modes : NormalModes
        Normal modes of a bed; those that are unstable have no frequency.
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
    """Draw the modulus of a transmissibility over the frequency.

    Parameters
    ----------
    frequencies : float (f,)
        Frequencies [Hz].
    values : complex (f,)
        Transmissibility, as `granular.linear.transmissibility` gives it.
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
    """Draw storage and loss stiffness of bed and piston over the frequency.

    Parameters
    ----------
    frequencies : float (f,)
        Frequencies [Hz].
    values : complex (f,)
        Dynamic stiffness [N/m], as `granular.linear.dynamic_stiffness` gives it.
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
