"""Export to extended XYZ, a text format for OVITO and ASE."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from granular.export.exporter import Exporter
from granular.export.frames import iterate_frames, load_run_if_path, present_grain_indices_and_frame
from granular.observables.frame import Frame
from granular.run.trajectory import Trajectory
from granular.shared.files import write_atomically

PROPERTIES = "species:S:1:pos:R:3:velo:R:3:force:R:3:radius:R:1:mass:R:1:id:I:1:kind:I:1:Z:I:1"
NO_ELEMENT = 0


def to_extxyz(
    run: Trajectory | str | Path, path: str | Path, *, overwrite: bool = False, progress: bool = False
) -> Path:
    """Write the frames of a run as extended XYZ, in SI and with full precision (17 digits).

    The cell of each frame (``Lattice`` with its ``Origin``) is as wide as the bed's cell and as deep as the
    distance between the plates. It is as high as the piston or, without a piston, as the bed. The grains lie
    in the middle between the plates, at z = 0. The columns have names that OVITO recognises: species, pos
    [m], velo [m/s], force [N] (magnetic, weight and contact), radius [m], mass [kg], id (the grain's index in
    the scene). ASE accepts only chemical elements; for ASE two more columns give kind (the index of the
    species in the scene) and the atomic number Z = 0. The comment line gives ``Time`` [s] and, with a piston,
    ``Piston_height`` [m]. Grains that have left the cell are omitted.

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
        If the file exists or cannot be written, or the run cannot be read.

    References
    ----------
    Format: https://github.com/libAtoms/extxyz; column names: OVITO's manual, "XYZ file reader".
    """
    run, path = load_run_if_path(run), Path(path)
    with write_atomically(path, overwrite) as part, part.open("w", encoding="utf-8") as file:
        for frame in iterate_frames(run, bar=path.name if progress else None):
            grains, present = present_grain_indices_and_frame(frame)
            file.write(
                f"{len(grains)}\n{_extxyz_comment_line(present)}\n{_extxyz_grain_lines(present, grains)}"
            )
    return path


def _extxyz_grain_lines(frame: Frame, grains: np.ndarray) -> str:
    numbers = " ".join(["%.17g"] * 11)
    names = ["_".join(specy.name.split()) or "grain" for specy in frame.scene.grains.species]
    forms = [f"{name.replace('%', '%%')} {numbers} %d {k} {NO_ELEMENT}\n" for k, name in enumerate(names)]
    table = np.zeros((len(grains), 12))
    for start, field in enumerate((frame.positions, frame.velocities, frame.forces)):
        table[:, 3 * start : 3 * start + 2] = field
    table[:, 9], table[:, 10], table[:, 11] = frame.diameters / 2.0, frame.masses, grains
    return "".join(forms[k] for k in frame.species) % tuple(table.ravel().tolist())


def _extxyz_comment_line(frame: Frame) -> str:
    cell = frame.scene.cell
    height, depth, piston = frame.piston_height, cell.separation, ""
    if frame.scene.piston is not None:
        piston = f" Piston_height={height:.17g}"
    elif cell.height is not None:
        height = cell.height
    else:
        radius = frame.diameters / 2.0
        height = float((frame.positions[:, 1] + radius).max(initial=radius.max(initial=0.0)))
    return (
        f'Lattice="{cell.width:.17g} 0 0 0 {height:.17g} 0 0 0 {depth:.17g}" '
        f'Origin="0 0 {-depth / 2.0:.17g}" Properties={PROPERTIES} Time={frame.time:.17g}'
        f'{piston} pbc="{"T T F" if cell.periods else "F F F"}"'
    )


EXTXYZ = Exporter(to_extxyz, "extended XYZ, for OVITO and ASE")
