"""A design: the data, and the files that they are written to."""

from __future__ import annotations

from pathlib import Path

from granular.shared.files import write_json
from reduced_models.designs.data import Check, DesignData, Round
from reduced_models.designs.maps import DamperMaps
from reduced_models.records.sources import prepared

__all__ = ["Check", "Design", "Round"]


class Design(DesignData):
    """A damper for a wish: `DesignData` that can be saved."""

    def save(self, out: str | Path, maps: DamperMaps) -> None:
        """Write report.html, design.json and scene.toml.

        Raises
        ------
        StoreError
            If the directory cannot be made or written to.
        """
        from reduced_models.designs.page import design_page

        target = prepared(out)
        assert target is not None
        write_json(target / "design.json", self.to_plain())
        self.scene.save(target / "scene.toml")
        design_page(self, maps).save(target / "report.html")
