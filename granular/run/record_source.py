"""The source of a record: its file or scene, and what was done to its samples."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

from granular.readers.read_options import ReadOptions, is_record_description, read_record_description

if TYPE_CHECKING:
    from granular.scene.scene import Scene


@dataclasses.dataclass(frozen=True)
class RecordSource:
    """File or scene behind a record, and notes on what was guessed, cut or repaired."""

    name: str  # empty if the record was made of arrays
    scene: str = ""
    digest: str = ""
    calibration: str = ""
    notes: tuple[str, ...] = ()


def source_of_file(path: Path, options: ReadOptions, notes: tuple[str, ...]) -> RecordSource:
    """Source of a record that was read from a file, or from that which a description names."""
    file, merged = path, options
    if is_record_description(path):
        file, described = read_record_description(path)
        merged = described.merge(options)
    calibrations = []
    for column, given in merged.calibrations().items():
        words = ", ".join(f"{key} {value}" for key, value in given.items() if key != "points")
        words = "a straight line through points" if "points" in given else words
        calibrations.append(words if column == "height" else f"{column} {words}")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return RecordSource(file.name, digest=digest, calibration="; ".join(calibrations), notes=notes)


def source_of_scene(scene: Scene, stage: str | None) -> RecordSource:
    """Source of a record that was simulated: the bed, its piston and what the record is of."""
    from granular.protocol.driven_piston_stages import Lift

    what = "the whole run" if stage is None else f"stage {stage!r}"
    for before, item in itertools.pairwise(scene.protocol):
        if item.name == stage and isinstance(before, Lift):
            what = f"free decay after a {1e3 * before.by:.3g} mm lift"
    mass = None if scene.piston is None else scene.piston.mass  # a driven piston may have none
    piston = "" if mass is None else f"piston {mass:.4g} kg, "
    return RecordSource(scene.name, scene=f"{scene.grains.count} magnets, {piston}{what}")
