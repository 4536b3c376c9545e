"""Export to GSD, the binary format of HOOMD-blue, for OVITO and freud."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from granular.export.exporter import Exporter
from granular.export.frames import (
    append_zero_z_coordinate,
    iterate_frames,
    load_run_if_path,
    present_grain_indices_and_frame,
)
from granular.observables.frame import Frame
from granular.run.trajectory import Trajectory
from granular.shared.errors import import_extra
from granular.shared.files import write_atomically


def to_gsd(
    run: Trajectory | str | Path, path: str | Path, *, overwrite: bool = False, progress: bool = False
) -> Path:
    """Write the frames of a run as GSD (schema ``hoomd``), in SI (m, kg, s).

    GSD stores positions, velocities, masses and diameters in single precision. Its two-dimensional box is
    centred on the origin and the same in all frames; positions are relative to its centre. A GSD box is
    always periodic. To prevent programs from finding neighbours across the walls, the box is therefore twice
    as wide as the cell, and twice as high as the highest position of the piston (or of a grain) in the run.
    OVITO opens every GSD file as periodic; `to_extxyz` marks each side as periodic or not. The exact values
    in double precision, in the coordinates of the cell, are also stored as logged quantities, which OVITO
    shows as properties of the particles: ``position``, ``velocity``, ``force`` (magnetic, weight and
    contact), each (k, 3), and ``grain`` (its index in the scene). Each frame also logs ``time`` [s] and, with
    a piston, ``piston_height`` [m]. The step is the index of the frame. Grains that have left the cell are
    omitted.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    path : path
        Path of the file to write.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        If the file exists or cannot be written, the run cannot be read, or the library ``gsd`` is
        missing.

    References
    ----------
    The schema: https://gsd.readthedocs.io/en/stable/schema-hoomd.html.
    """
    hoomd = import_extra("gsd.hoomd", "GSD", "export")
    run, path = load_run_if_path(run), Path(path)
    low, size = _corner_and_size_of_bounding_box(run)
    with write_atomically(path, overwrite) as part, hoomd.open(name=str(part), mode="w") as file:
        for number, frame in enumerate(iterate_frames(run, bar=path.name if progress else None)):
            file.append(_fill_gsd_frame(hoomd.Frame(), number, frame, low, size))
    return path


def _corner_and_size_of_bounding_box(run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return lower left corner (2,) and size (2,) of a box that contains the cell at all times [m]."""
    if run.scene.cell.periods is not None:
        return np.zeros(2), np.array(run.scene.cell.periods)
    heights = [0.0] if run.scene.piston is None else run.dataset["frame_height"].values
    low, high = np.zeros(2), np.array([run.scene.cell.width, np.nanmax(heights)])
    for frame in iterate_frames(run):
        low = np.minimum(low, np.fmin.reduce(frame.positions, initial=np.inf))
        high = np.maximum(high, np.fmax.reduce(frame.positions, initial=-np.inf))
    return low, high - low


def _fill_gsd_frame(new: Any, number: int, frame: Frame, low: np.ndarray, size: np.ndarray) -> Any:
    grains, present = present_grain_indices_and_frame(frame)
    # A closed cell gets a box of twice its size, so that no image of a grain is near.
    box = size if frame.scene.cell.periods else 2.0 * size
    new.configuration.step = number
    new.configuration.dimensions = 2
    new.configuration.box = [*box.tolist(), 0.0, 0.0, 0.0, 0.0]
    particles = new.particles
    particles.N = len(grains)
    particles.types = [specy.name for specy in frame.scene.grains.species]
    particles.typeid = present.species.astype(np.uint32)
    particles.diameter, particles.mass = present.diameters, present.masses
    particles.position = append_zero_z_coordinate(present.positions - low - size / 2.0)
    particles.velocity = append_zero_z_coordinate(present.velocities)
    new.log = {
        "time": np.array([frame.time]),
        "particles/position": append_zero_z_coordinate(present.positions),
        "particles/velocity": append_zero_z_coordinate(present.velocities),
        "particles/force": append_zero_z_coordinate(present.forces),
        "particles/grain": grains.astype(np.int32),
    }
    if frame.scene.piston is not None:
        new.log["piston_height"] = np.array([frame.piston_height])
    return new


GSD = Exporter(to_gsd, "GSD, for OVITO and freud")
