"""What a calibration found: the data, its page, and the files that they are written to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from granular.shared.files import write_json
from reduced_models.calibration.data import Calibrated, CalibrationData, Match
from reduced_models.records.sources import prepared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from granular.shared.html import Page

__all__ = ["Calibrated", "Calibration", "Match"]


class Calibration(CalibrationData):
    """What a record says of the numbers of a scene: `CalibrationData` with files and pictures."""

    def plot(self) -> Figure:
        """The record, the simulations over it, and how far their features are apart."""
        from reduced_models.calibration.page import calibration_plot

        return calibration_plot(self)

    def page(self) -> Page:
        """The result as a page."""
        from reduced_models.calibration.page import calibration_page

        return calibration_page(self)

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
