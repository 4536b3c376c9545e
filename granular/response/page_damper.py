"""The parts of a response's report on the damper: what it is to the machine, what it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.response.page_parts import amplitude_words, shown_part
from granular.response.response import Response
from granular.shared.html import Page, number
from granular.shared.plotting import COLOURS, READABLE, figure

if TYPE_CHECKING:
    import xarray

MARKS = "os^vDP*X"
LOSSES = {
    "affine_loss_a_period": "affine drag",
    "rearranging": "rearranging",
    "friction_loss_a_period": "friction",
    "wall_friction_loss_a_period": "wall friction",
    "contact_loss_a_period": "contacts",
    "eddy_loss_a_period": "eddy currents",
    "piston_loss_a_period": "piston",
    "host_loss_a_period": "dashpots",
}


def add_damper(page: Page, found: Response) -> None:
    """What the damper is to the machine, over frequency and over the machine's displacement."""
    page.section("The swings, and what the damper is to the machine")
    data = found.dataset
    if "added_damping" in data:
        _equivalents(page, found)
        page.text(
            "What the damper adds to the machine is the mass, and the dashpot, that would leave it "
            "the same displacement. The added stiffness is the added mass, times -omega². The loss "
            "factor is the power that the damper takes over that which swings to and fro; where "
            "next to nothing swings, it is large and says little."
        )
    for size in data.amplitude.values.tolist():
        _swings(page, found, size)
    words = "Piston is the amplitude of the piston over the cell"
    if "unsteady" in data:
        words += "; unsteady says by how much the machine's amplitude changes while it is taken"
    page.text(f"{words}.")


def _equivalents(page: Page, found: Response) -> None:
    with figure(2, 1, height=6.4, size=READABLE, sharex=True) as (drawing, both):
        for k, size in enumerate(found.dataset.amplitude.values.tolist()):
            part = found.dataset.sel(amplitude=size)
            swing, colour = 1e3 * part.displacement, COLOURS[k % len(COLOURS)]
            look = {"color": colour, "linestyle": "none", "marker": MARKS[k % len(MARKS)]}
            both[0].plot(swing, part.added_damping, label=amplitude_words(found, size), **look)
            both[1].plot(swing, 1e-3 * part.added_stiffness, **look)
        both[0].set_ylabel("added damping [kg/s]")
        both[1].set_ylabel("stiffness [kN/m]")
        both[1].set_xlabel("displacement of the machine [mm]")
        drawing.legend(loc="outside upper left", ncols=2)
        page.figure(
            drawing,
            "Damping and stiffness that the damper adds to the machine, over the machine's "
            "displacement: a point a frequency. A linear damper has the same values at all "
            "amplitudes of one frequency.",
        )


def _swings(page: Page, found: Response, size: float) -> None:
    part, diameter = shown_part(found, size), found.scene.grains.species[0].diameter
    columns = {
        "Hz": (part.frequency, 1.0, 4), "mm": (part.displacement, 1e3, 3),
        "piston [D]": (part.get("stroke"), 1.0 / diameter, 2),
        "added kg": (part.get("effective_mass"), 1.0, 3),
        "added kg/s": (part.get("added_damping"), 1.0, 3),
        "loss factor": (part.get("loss_factor"), 1.0, 2),
        "unsteady": (part.get("unsteady"), 1.0, 2),
    }  # fmt: skip
    known = {
        head: [_figure(scale * float(x), digits) for x in values.values]
        for head, (values, scale, digits) in columns.items()
        if values is not None
    }
    page.text(f"{amplitude_words(found, size)}:")
    page.table(tuple(known), list(zip(*known.values(), strict=True)))


def _figure(value: float, digits: int) -> str:
    """A number for a table; without an exponent where it can be."""
    if value == 0.0 or not np.isfinite(value) or not 1e-3 <= abs(value) < 1e6:
        return number(value, digits)
    places = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{places}f}"


def add_energy(page: Page, found: Response) -> None:
    """Where the energy of a period goes, at each amplitude."""
    if "work_a_period" not in found.dataset:
        return
    page.section("Where the energy of a period goes")
    for size in found.dataset.amplitude.values.tolist():
        part = shown_part(found, size)
        losses = losses_of(part)
        columns = {"work": part.work_a_period.values, **losses}
        head = ["Hz", *(f"{name} [mJ]" for name in columns)]
        rows = [
            [_figure(float(f), 4), *(_figure(1e3 * float(one[k]), 3) for one in columns.values())]
            for k, f in enumerate(part.frequency.values)
        ]
        page.text(f"{amplitude_words(found, size)}:")
        page.table(head, rows)
    page.text(
        "Work is what shakes the machine does in a period, the others are where it goes. Affine "
        "drag is that of grains which follow the piston evenly, a third of them at its speed; "
        "rearranging is all drag beyond that, of grains that change their places, and below 0 "
        "where they follow less. What is missing, or too much, is in a swing that still changes."
    )


def losses_of(part: xarray.Dataset) -> dict[str, np.ndarray]:
    """Energies (f,) that are lost in a period [J], by their names, without those that are 0."""
    values = {str(name): one.values for name, one in part.data_vars.items()}
    if "affine_loss_a_period" in values and "drag_loss_a_period" in values:
        values["rearranging"] = values["drag_loss_a_period"] - values["affine_loss_a_period"]
    known = {name: values[key] for key, name in LOSSES.items() if key in values}
    told = {*LOSSES, "drag_loss_a_period", "work_a_period"}
    for key, one in values.items():  # of effects of a user's own
        if key.endswith("_loss_a_period") and key not in told:
            known[key.removesuffix("_loss_a_period").replace("_", " ")] = one
    return {name: one for name, one in known.items() if np.any(one != 0.0)}
