"""What a calibration found: the data, its page, and the files that they are written to."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from granular.shared.files import write_json
from granular.shared.html import Page
from granular.shared.plotting import COLOURS, GREY, figure
from reduced_models.calibration.data import Calibrated, CalibrationData, Match
from reduced_models.records.sources import prepared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Calibrated", "Calibration", "Match"]


class Calibration(CalibrationData):
    """What a record says of the numbers of a scene: `CalibrationData` with files and pictures."""

    def plot(self) -> Figure:
        """The record, the simulations over it, and how far their features are apart."""
        with figure(2, 1, height=5.4, height_ratios=(2, 1)) as (drawing, (top, bottom)):
            time = self.record.time - self.record.time[0]
            top.plot(time, 1e3 * self.record.height, color=GREY, linewidth=3, label="record")
            for k, motion in enumerate(self.motions):
                label = "simulated, one line a random start" if k == 0 else None
                top.plot(motion.time, 1e3 * motion.height, color=COLOURS[0], linewidth=0.7,
                         label=label)  # fmt: skip
            top.set_ylabel("height [mm]")
            top.set_xlabel("time [s]")
            top.legend()
            names = [one.name.replace("_", " ") for one in self.matches]
            bottom.errorbar(
                [100.0 * (one.simulated / one.record - 1.0) for one in self.matches],
                names,
                xerr=[200.0 * math.hypot(one.noise, one.scatter) for one in self.matches],
                fmt="o",
                color=COLOURS[1],
                capsize=3,
            )
            bottom.axvline(0.0, color=GREY)
            bottom.set_xlabel("simulated over record, with two standard deviations [%]")
            bottom.margins(y=0.3)
            return drawing

    def page(self) -> Page:
        """The result as a page."""
        page = Page(f"Scene {self.scene.name!r} calibrated", "; ".join(map(str, self.parameters)))
        for note in (*map(str, self.undetermined), *self.notes):
            page.note(note)
        page.table(
            ("number", "value", "unit", f"{100 * self.confidence:g} % interval", "before",
             "noise [%]", "random starts [%]", "step [%]"),
            [
                (
                    one.key, f"{one.value:.6g}", one.unit,
                    f"{one.interval[0]:.6g} to {one.interval[1]:.6g}", f"{one.start:.6g}",
                    *("" if part is None else f"{100 * part:.2g}"
                      for part in (one.noise, one.scatter, one.step)),
                )
                for one in self.parameters
            ],
        )  # fmt: skip
        page.figure(self.plot(), "The record, the simulations, and their features.")
        page.section("The scene")
        page.preformatted(self.scene.to_toml())
        return page

    def save(self, out: str | Path) -> None:
        """Write report.html, calibration.json and the calibrated scene.toml.

        Raises
        ------
        StoreError
            If the directory cannot be made or written to.
        """
        target = prepared(out)
        assert target is not None
        write_json(target / "calibration.json", self.to_plain())
        self.scene.save(target / "scene.toml")
        self.page().save(target / "report.html")
