"""Energy over long runs: trends, errors over time, phase portraits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, GREY, STYLES, figure
from validation.energy import EnergyStudy
from validation.energy import summary as energy_table
from validation.parts import Plain
from validation.sections.common import WIDTH, Shown, legend, note_failures, sound, tabulate
from validation.trend import SIGNIFICANCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 40


def energy_section(page: Page, results: Sequence[Plain]) -> None:
    """Trends, the error over time, and phase portraits."""
    found = [EnergyStudy.from_plain(one) for one in sound(results)]
    page.section("Energy over long runs")
    page.text(
        "Error of the energy over the energy turned over. A trend is claimed where it stands out "
        f"against stationary noise and against a random walk, at p below {SIGNIFICANCE:g}. "
        "Symplectic methods, and reversible variable steps, should show none; the controls gain "
        "(explicit Euler) or lose (Runge-Kutta)."
    )
    tabulate(page, energy_table(found))
    for one in found:
        if not energy_holds(one):
            page.note(
                f"{one.method} on the {one.system} {one.trend.verdict()} energy by "
                f"{one.trend.drift:.1e} (p = {one.trend.p_value:.1g}), unlike its kind."
            )
    for system in dict.fromkeys(one.system for one in found):
        _energy_figures(page, system, [one for one in found if one.system == system])
    note_failures(page, results)


CONTROLS = {"explicit-euler": "gains", "runge-kutta-4": "loses"}
"""What the trend of each control should be."""


def energy_holds(one: EnergyStudy) -> bool:
    """Whether a run is of its kind: without a trend, or with a control's.

    Of a user's method that is not symplectic nothing is claimed.
    """
    if not one.keeps and one.method not in CONTROLS:
        return True
    return one.trend.verdict() == ("none" if one.keeps else CONTROLS[one.method])


def _energy_figures(page: Page, system: str, group: Sequence[EnergyStudy]) -> None:
    for kind, keeps in (("symplectic or reversible", True), ("controls", False)):
        ones = [one for one in group if one.keeps is keeps]
        if not ones:
            continue
        with figure(width=WIDTH, height=4.2) as (drawing, axes):
            for k, one in enumerate(ones):
                axes.semilogy(
                    *_envelope(one),
                    color=COLOURS[k % len(COLOURS)],
                    linestyle=STYLES[k // len(COLOURS)],
                    label=f"{one.method}, {one.steps:.2g} steps",
                )
            low, high = axes.get_ylim()
            axes.set_ylim(min(low, 0.1 * high), 2.0 * high)  # what hardly changes looks so
            axes.set_ylabel("greatest energy error")
            axes.set_xlabel("share of the run")
            legend(axes)
            page.figure(
                drawing,
                f"{system}, {kind}: greatest error of the energy in each {BINS}th of the run (of "
                f"{_lengths(ones)}), over the energy turned over.",
            )
    portraits = [one for one in group if one.heights]
    if portraits:
        _phase_portraits(page, system, portraits)


def _lengths(ones: Sequence[EnergyStudy]) -> str:
    lengths = sorted({f"{one.times[-1]:.3g}" for one in ones}, key=float)
    return f"{lengths[0]} s" if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]} s"


def _envelope(one: EnergyStudy) -> tuple[np.ndarray, np.ndarray]:
    """Middle of each part of the run, over its length, and the greatest error in it."""
    bins = min(BINS, len(one.errors))
    greatest = np.array([part.max() for part in np.array_split(np.abs(one.errors), bins)])
    middles = np.array([part.mean() for part in np.array_split(np.array(one.times), bins)])
    return middles / one.times[-1], np.where(greatest > 0.0, greatest, np.nan)


def _phase_portraits(page: Page, system: str, group: Sequence[EnergyStudy]) -> None:
    chosen = [one for one in group if one.method in _PORTRAYED] or list(group[:1])
    with figure(2, len(chosen), height=5.0, width=2.6 * len(chosen) + 0.8, squeeze=False) as (
        drawing,
        panels,
    ):
        for column, one in zip(panels.T, chosen, strict=True):
            for axes in column:
                axes.plot(one.heights, one.velocities, ".", color=COLOURS[0], markersize=1.2)
            column[0].set_title(one.method, fontsize=9)
            _zoom(column[1], one)
            column[1].set_xlabel("height [D]")
        panels[0, 0].set_ylabel("velocity [m/s]")
        panels[1, 0].set_ylabel("velocity [m/s], zoom")
        page.figure(drawing, f"{system}: phase portraits, and a zoom at the upper turning point.")


_PORTRAYED = ("stormer-verlet", "stormer-verlet+compensated", "explicit-euler", "runge-kutta-4")


def _zoom(axes: Axes, one: EnergyStudy) -> None:
    """The upper turning point, wide enough for a drift of a hundredth."""
    top, fastest = one.heights[0], max(map(abs, one.velocities))
    axes.set_xlim(0.98 * top, 1.02 * top)
    axes.set_ylim(-0.25 * fastest, 0.25 * fastest)
    axes.axvline(top, color=GREY, linewidth=0.8)


def _text(results: Sequence[Plain]) -> str:
    return energy_table([EnergyStudy.from_plain(one) for one in results]).text()


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [EnergyStudy.from_plain(one) for one in results]
    right = sum(map(energy_holds, found))
    words = f"{right} of {len(found)} energy runs are of their kind (no trend, or a control's)"
    return words, right == len(found)


ENERGY = Shown(_text, _verdict, energy_section)
