"""What was identified: the data, and the files that they are written to."""

from __future__ import annotations

from pathlib import Path

from granular.shared.files import make_directory, write_text
from reduced_models.identification.data import IdentificationData
from reduced_models.laws.catalogue import LAWS


class Identification(IdentificationData):
    """What was identified: `IdentificationData` that can be saved."""

    def save(self, out: str | Path) -> None:
        """Write report.html, model.json and equations.txt (the best), models/ and record.csv.

        Where laws were judged on falls, the best one as fall.json, and its fall as fall.csv.
        """
        from reduced_models.identification.page import identification_page

        out = Path(out)
        make_directory(out / "models")
        self.record.to_csv(out / "record.csv")
        self.best.save(out / "model.json")
        write_text(out / "equations.txt", self.best.text)
        for place, model in enumerate(self.models):
            # The name of a law that was given as an equation is no file name.
            name = model.law.name if model.law.name in LAWS else f"own-{place + 1}"
            model.save(out / "models" / f"{name}.json")
        if self.falls is not None and self.falls.best.model is not None:
            self.falls.record.to_csv(out / "fall.csv")
            self.falls.best.model.save(out / "fall.json")
        identification_page(self).save(out / "report.html")
