"""Extended XYZ, a text format that OVITO and ASE read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from granular.export.frames import BedFrame, iterate_frames, open_run
from granular.run.trajectory import Trajectory
from granular.shared.files import write_atomically

PROPERTIES = "species:S:1:pos:R:3:velo:R:3:force:R:3:radius:R:1:mass:R:1:id:I:1:kind:I:1:Z:I:1"
NO_ELEMENT = 0


def to_extxyz(
    run: Trajectory | str | Path, path: str | Path, *, overwrite: bool = False, progress: bool = False
) -> Path:
    """Write the frames of a run as extended XYZ, in SI and to the last bit (17 digits).

    The cell of each frame (``Lattice`` with its ``Origin``) is as wide as the bed's, as high as the
    piston stands (without a piston, as the bed) and as deep as the distance of the plates; the
    grains stand half-way between these, at z = 0. The columns bear the names that OVITO maps to its
    own: species, pos [m], velo [m/s], force [N] (magnetic, weight and contact), radius [m],
    mass [kg], id (the grain's index in the scene); and for ASE, which takes chemical elements only,
    kind (the index of the species in the scene) and the atomic number Z = 0. The comment line gives
    ``Time`` [s] and, with a piston, ``Piston_height`` [m]. Grains that have left the cell are left
    out.

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
        If the file exists or cannot be written, or the run cannot be read.

    References
    ----------
    The format: https://github.com/libAtoms/extxyz; the names of the columns: OVITO's manual, "XYZ
    file reader".
    """
    run, path = open_run(run), Path(path)
    with write_atomically(path, overwrite) as part, part.open("w", encoding="utf-8") as file:
        grain_lines = _grain_line_writer(run)
        for frame in iterate_frames(run, bar=path.name if progress else None):
            file.write(f"{len(frame.grains)}\n{_comment_line(run, frame)}\n{grain_lines(frame)}")
    return path


def _grain_line_writer(run: Trajectory) -> Callable[[BedFrame], str]:
    """Return a function that writes the lines of a frame's grains."""
    grains = run.scene.grains
    names = ["_".join(specy.name.split()) or "grain" for specy in grains.species]
    numbers = " ".join(["%.17g"] * 11)
    forms = [
        f"{names[k].replace('%', '%%')} {numbers} %d {k} {NO_ELEMENT}\n" for k in grains.species_indices()
    ]
    radius, mass = grains.diameters() / 2.0, grains.masses()

    def lines(frame: BedFrame) -> str:
        table = np.zeros((len(frame.grains), 12))
        for start, field in enumerate((frame.position, frame.velocity, frame.force)):
            table[:, 3 * start : 3 * start + 2] = field
        table[:, 9], table[:, 10] = radius[frame.grains], mass[frame.grains]
        table[:, 11] = frame.grains
        return "".join(forms[i] for i in frame.grains) % tuple(table.ravel().tolist())

    return lines


def _comment_line(run: Trajectory, frame: BedFrame) -> str:
    cell = run.scene.cell
    periodic = cell.periods is not None
    height = cell.height if periodic else frame.height
    if height is None:
        radius = run.scene.grains.diameters()[frame.grains] / 2.0
        height = float((frame.position[:, 1] + radius).max(initial=radius.max(initial=0.0)))
    depth = cell.separation
    piston = "" if frame.height is None else f" Piston_height={frame.height:.17g}"
    return (
        f'Lattice="{cell.width:.17g} 0 0 0 {height:.17g} 0 0 0 {depth:.17g}" '
        f'Origin="0 0 {-depth / 2.0:.17g}" Properties={PROPERTIES} Time={frame.time:.17g}'
        f'{piston} pbc="{"T T F" if periodic else "F F F"}"'
    )
