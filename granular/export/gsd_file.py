"""GSD, the binary format of HOOMD-blue, which OVITO and freud read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from granular.export.frames import BedFrame, iterate_frames, open_run, planar_to_spatial
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.files import write_atomically


def to_gsd(
    run: Trajectory | str | Path, path: str | Path, *, overwrite: bool = False, progress: bool = False
) -> Path:
    """Write the frames of a run as GSD (schema ``hoomd``), in SI (m, kg, s).

    GSD holds positions, velocities, masses and diameters in single precision, and its box is
    centred on the origin: the positions are counted from the middle of a box that is the same in
    all frames, in two dimensions. The box is twice as wide as the cell, and twice as high as the
    highest piston (or grain) of the run: a GSD box is always periodic, and so no program that
    counts neighbours finds any across the walls. OVITO opens each GSD file as periodic; `to_extxyz`
    says of every side what it is. The exact values in double precision, in the coordinates of the
    cell, are stored too as logged quantities, which OVITO shows as properties of the particles:
    ``position``, ``velocity``, ``force`` (magnetic, weight and contact), each (k, 3), and ``grain``
    (its index in the scene); and for the frame ``time`` [s] and, with a piston, ``piston_height``
    [m]. The step is the number of the frame. Grains that have left the cell are left out.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    path : path
        The file.
    overwrite : bool
        Whether a file of that name may be replaced.
    progress : bool
        Whether to show a bar.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the file exists or cannot be written, the run cannot be read, or the library ``gsd`` is
        missing.

    References
    ----------
    The schema: https://gsd.readthedocs.io/en/stable/schema-hoomd.html.
    """
    try:
        import gsd.hoomd
    except ImportError:
        raise InputError(
            "GSD needs the library gsd; install it with: pip install 'granular-damper[export]'"
        ) from None
    run, path = open_run(run), Path(path)
    low, size = _bounding_box_of_run(run)
    with write_atomically(path, overwrite) as part, gsd.hoomd.open(name=str(part), mode="w") as file:
        constant_fields = _constant_fields(run)
        for frame in iterate_frames(run, bar=path.name if progress else None):
            file.append(_fill_gsd_frame(gsd.hoomd.Frame(), frame, constant_fields, low, size))
    return path


def _bounding_box_of_run(run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Lower left corner and size of what holds the cell at any time (2,), (2,) [m]."""
    if run.scene.cell.periods is not None:
        return np.zeros(2), np.array(run.scene.cell.periods)
    heights = [0.0] if run.scene.piston is None else run.dataset["frame_height"].values
    low, high = np.zeros(2), np.array([run.scene.cell.width, np.nanmax(heights)])
    for frame in iterate_frames(run):
        low = np.minimum(low, frame.position.min(axis=0, initial=np.inf))
        high = np.maximum(high, frame.position.max(axis=0, initial=-np.inf))
    return low, high - low


def _constant_fields(run: Trajectory) -> dict[str, Any]:
    """Fields that are the same in all frames, by name, for all grains of the scene."""
    grains = run.scene.grains
    return {
        "types": [specy.name for specy in grains.species],
        "typeid": grains.species_indices().astype(np.uint32),
        "diameter": grains.diameters(),
        "mass": grains.masses(),
        # About a closed cell as much again, so that no image of a grain is near.
        "box": 2.0 if run.scene.cell.periods is None else 1.0,
    }


def _fill_gsd_frame(
    new: Any, frame: BedFrame, constant_fields: dict[str, Any], low: np.ndarray, size: np.ndarray
) -> Any:
    new.configuration.step = frame.number
    new.configuration.dimensions = 2
    new.configuration.box = [*(constant_fields["box"] * size).tolist(), 0.0, 0.0, 0.0, 0.0]
    particles = new.particles
    particles.N = len(frame.grains)
    particles.types = constant_fields["types"]
    for name in ("typeid", "diameter", "mass"):
        setattr(particles, name, constant_fields[name][frame.grains])
    particles.position = planar_to_spatial(frame.position - low - size / 2.0)
    particles.velocity = planar_to_spatial(frame.velocity)
    new.log = {
        "time": np.array([frame.time]),
        "particles/position": planar_to_spatial(frame.position),
        "particles/velocity": planar_to_spatial(frame.velocity),
        "particles/force": planar_to_spatial(frame.force),
        "particles/grain": frame.grains.astype(np.int32),
    }
    if frame.height is not None:
        new.log["piston_height"] = np.array([frame.height])
    return new
