"""The report of a response: one HTML file."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from granular.response.page_damper import add_damper, add_energy
from granular.response.page_parts import amplitude_words, labels, shown_rows
from granular.response.response import Response
from granular.response.transients import pace_of_sweep
from granular.shared.html import Page, number
from granular.shared.plotting import COLOURS, READABLE, figure, plain_numbers
from granular.shared.version import versions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNSTEADY = 0.05
"""Change of the amplitude, while it is taken, from which on a reader is told."""
PACE = 0.3
"""Of a sweep (`pace_of_sweep`), from which on a reader is told."""
_DASHES: tuple[Literal["--", ":", "-."], ...] = ("--", "-.", ":")
_DENSE = 60
"""Frequencies from which on points are not marked."""


@dataclasses.dataclass(frozen=True, eq=False)
class Beside:
    """What is shown beside a response, such as a law.

    Attributes
    ----------
    title, words : str
        Of its section.
    header : sequence of str
    rows : sequence of sequence of str
        Its table.
    frequencies : float64 (f,)
        [Hz]
    curves : mapping of str to mapping of float to float64 (f,)
        Displacements [m] by the name of the curve and the amplitude; at most three names.
    notes : sequence of str
        What must not be overlooked.
    """

    title: str
    words: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    frequencies: np.ndarray
    curves: Mapping[str, Mapping[float, np.ndarray]]
    notes: Sequence[str] = ()


def response_page(found: Response, beside: Beside | None = None, missing: str = "") -> Page:
    """The report as a page: what is left, what the damper is to the machine, how it was simulated.

    ``missing`` says why nothing stands beside it, where something could.
    """
    page = Page(f"The response of scene {found.scene.name!r}", response_words(found))
    _curves(page, found, beside)
    _peaks(page, found)
    add_steadiness(page, found)
    if beside is not None:
        page.section(beside.title)
        page.table(beside.header, beside.rows)
        page.text(beside.words)
        for words in beside.notes:
            page.note(words)
    elif missing:
        page.note(missing)
    add_damper(page, found)
    add_energy(page, found)
    _settings(page, found)
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    made = versions(("matplotlib", "scipy", "xarray"))
    page.footer(f"Made on {now} with " + ", ".join(f"{k} {v}" for k, v in made.items()))
    return page


def response_words(found: Response) -> str:
    """The answer in one sentence, at the greatest amplitude."""
    row = max(found.peaks(), key=lambda one: one["amplitude"])
    words = (
        f"{amplitude_words(found, row['amplitude'])}: {_mm(row['peak'])} mm at most, at "
        f"{row['frequency']:.3g} Hz"
    )
    if "alone" not in row:
        return f"{words}."
    return (
        f"{words}; {_mm(row['alone'])} mm without the damper, {row['reduction']:.3g} times as "
        f"much, and {_mm(row['ideal'])} mm with the ideal tuned mass of the same weight."
    )


def _curves(page: Page, found: Response, beside: Beside | None) -> None:
    with figure(height=5.4, size=READABLE) as (drawing, axes):
        found.plot(axes)
        axes.get_legend().remove()
        plain_numbers(axes.yaxis)
        count = found.dataset.sizes["amplitude"]
        own = axes.get_lines()[:count]
        for k, line in enumerate(own):
            line.set(color=COLOURS[k % len(COLOURS)], linestyle="-", linewidth=1.6)
            if found.dataset.sizes["frequency"] < _DENSE:
                line.set(marker="o", markersize=5)
        names = _beside_lines(axes, found, beside)
        handles, words = axes.get_legend_handles_labels()
        drawing.legend([*handles, *names.values()], [*words, *names], loc="outside upper left",
                       ncols=1 if len(words) + len(names) < 4 else 2)  # fmt: skip
        page.figure(drawing, _caption(found, beside))


def _beside_lines(axes: Axes, found: Response, beside: Beside | None) -> Mapping[str, object]:
    """Draw the curves beside; for the legend, a line of each name."""
    from matplotlib.lines import Line2D

    handles: dict[str, object] = {}
    if beside is None:
        return handles
    sizes = found.dataset.amplitude.values.tolist()
    for (name, curves), look in zip(
        beside.curves.items(), _DASHES, strict=False
    ):  # fmt: skip
        for size, curve in curves.items():
            colour = COLOURS[sizes.index(size) % len(COLOURS)]
            axes.plot(beside.frequencies, 1e3 * curve, color=colour, linestyle=look, lw=1.3)
        handles[name] = Line2D([], [], color=COLOURS[-1], linestyle=look, lw=1.3)
    return handles


def _caption(found: Response, beside: Beside | None) -> str:
    words = "Displacement of the machine"
    if found.scene.effects.host is not None and not found.scene.effects.host.bodies:
        words = "Displacement of the load on the piston"
    if "alone" in found.dataset:
        words += ", with the damper, without it, and with Den Hartog's tuned mass in its place"
    if beside is not None:
        words += f"; in the colour of each amplitude: {', '.join(beside.curves)}"
    return f"{words}."


def _peaks(page: Page, found: Response) -> None:
    page.section("The peaks")
    rows = found.peaks()
    head = [labels(found)[0], "at [Hz]", "peak [mm]"]
    keys = ["alone", "ideal"] if "alone" in rows[0] else []
    head += ["alone [mm]", "ideal [mm]", "times lower"] if keys else []
    cells = [
        [f"{row['amplitude']:g}", number(row["frequency"]), _mm(row["peak"]),
         *(_mm(row[key]) for key in keys),
         *([number(row["reduction"], 3)] if keys else [])]
        for row in rows
    ]  # fmt: skip
    page.table(head, cells)
    if keys:
        page.text(
            "Alone is the machine without the damper; ideal is Den Hartog's tuned mass of the "
            "damper's weight, on a spring and a dashpot of the best size. Both are exact, and "
            "taken between the lowest and the highest frequency above."
        )
        curve = found.linear_curves(rows[-1]["amplitude"])["alone"]
        if int(curve.argmax()) in (0, len(curve) - 1):
            page.note(
                "The machine alone swings most outside of these frequencies: how many times the "
                "damper lowers its peak is told by a response that reaches further."
            )


def add_steadiness(page: Page, found: Response) -> None:
    """Notes on swings that are not steady, and on a sweep that was too fast, where they are."""
    data = found.dataset
    pace = pace_of_sweep(found)
    if pace is not None and pace > PACE:
        wanted = found.settings["duration"] * pace / (0.5 * PACE)
        page.note(
            f"The sweep was too fast for the peak: its frequency changes {pace:.2g} times as fast "
            f"as the machine with its damper can follow. Give a sweep of {wanted:.0f} s or more, "
            "or steady sines."
        )
    if "unsteady" not in data:
        return
    worst = data.unsteady.where(data.unsteady == data.unsteady.max(), drop=True)
    if float(worst.max()) > UNSTEADY:
        page.note(
            f"Not all swings are steady. {amplitude_words(found, float(worst.amplitude[0]))}, at "
            f"{float(worst.frequency[0]):.4g} Hz, the amplitude still changes "
            f"by {100.0 * float(worst.max()):.2g} % while it is taken. Where that matters, "
            "let the sines act for longer (--duration)."
        )


def _settings(page: Page, found: Response) -> None:
    page.section("Settings")
    rows = [("time step", str(found.settings.get("dt", "not told")))]
    sweep, lasts = found.settings.get("sweep"), found.settings.get("duration")
    if sweep is not None:
        rows.append(("one sweep", f"{sweep[0]:g} to {sweep[1]:g} Hz in {lasts:g} s"))
        pace = pace_of_sweep(found)
        rows.append(("its pace at the peak", "not known" if pace is None else number(pace, 2)))
    elif lasts is not None:
        rows.append(("each sine acts for", f"{lasts:g} s, of which the last 0.4 are taken"))
    rows.append(("frequencies", str(found.dataset.sizes["frequency"])))
    page.table(("setting", "value"), rows)
    if shown_rows(found) < found.dataset.sizes["frequency"]:
        page.text("The tables show some of the frequencies; response.csv holds all.")
    page.preformatted(found.scene.to_toml())


def _mm(metres: float) -> str:
    return number(1e3 * metres, 3)
