"""The page of a calibration, and its figure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, GREY, figure
from reduced_models.calibration.data import CalibrationData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_page(found: CalibrationData) -> Page:
    """The result as a page."""
    page = Page(f"Scene {found.scene.name!r} calibrated", "; ".join(map(str, found.parameters)))
    for note in (*map(str, found.undetermined), *found.notes):
        page.note(note)
    page.table(
        ("number", "value", "unit", f"{100 * found.confidence:g} % interval", "before",
         "noise [%]", "random starts [%]", "step [%]"),
        [
            (
                one.key, f"{one.value:.6g}", one.unit,
                f"{one.interval[0]:.6g} to {one.interval[1]:.6g}", f"{one.start:.6g}",
                *("" if part is None else f"{100 * part:.2g}"
                  for part in (one.noise, one.scatter, one.step)),
            )
            for one in found.parameters
        ],
    )  # fmt: skip
    page.figure(calibration_plot(found), "The record, the simulations, and their features.")
    page.section("The scene")
    page.preformatted(found.scene.to_toml())
    return page


def calibration_plot(found: CalibrationData) -> Figure:
    """The record, the simulations over it, and how far their features are apart."""
    with figure(2, 1, height=5.4, height_ratios=(2, 1)) as (drawing, (top, bottom)):
        time = found.record.time - found.record.time[0]
        top.plot(time, 1e3 * found.record.height, color=GREY, linewidth=3, label="record")
        for k, motion in enumerate(found.motions):
            label = "simulated, one line a random start" if k == 0 else None
            top.plot(motion.time, 1e3 * motion.height, color=COLOURS[0], linewidth=0.7,
                     label=label)  # fmt: skip
        top.set_ylabel("height [mm]")
        top.set_xlabel("time [s]")
        top.legend()
        names = [one.name.replace("_", " ") for one in found.matches]
        bottom.errorbar(
            [100.0 * (one.simulated / one.record - 1.0) for one in found.matches],
            names,
            xerr=[200.0 * math.hypot(one.noise, one.scatter) for one in found.matches],
            fmt="o",
            color=COLOURS[1],
            capsize=3,
        )
        bottom.axvline(0.0, color=GREY)
        bottom.set_xlabel("simulated over record, with two standard deviations [%]")
        bottom.margins(y=0.3)
        return drawing
