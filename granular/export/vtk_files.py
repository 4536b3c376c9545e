"""Export to VTK files for ParaView: one file per frame, and a list of them with their times."""

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
from granular.shared.files import write_files_atomically

LIST = "bed.pvd"


def to_vtk(
    run: Trajectory | str | Path, directory: str | Path, *, overwrite: bool = False, progress: bool = False
) -> tuple[Path, ...]:
    """Write the frames of a run as VTK files, in SI and double precision.

    Open ``bed.pvd`` in ParaView, and show the points as spheres scaled by ``radius``. Each frame is an
    unstructured grid of points at z = 0 (``bed_00000.vtu``, ...). The points have ``velocity`` [m/s] and
    ``force`` [N] (magnetic, weight and contact), both (k, 3), ``radius`` [m], ``mass`` [kg], ``species`` and
    ``grain`` (indices in the scene). Grains that have left the cell are omitted.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    directory : path
        Directory of the files; created if missing.
    overwrite : bool
        Whether existing files may be replaced.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    tuple of Path
        Path of the list, followed by the files of the frames.

    Raises
    ------
    InputError
        If a file exists or cannot be written, the run cannot be read, or the library ``meshio`` is
        missing.

    References
    ----------
    https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
    """
    meshio = import_extra("meshio", "VTK", "export")
    run, directory = load_run_if_path(run), Path(directory)
    times = run.dataset["frame_time"].values
    names = [f"bed_{k:05d}.vtu" for k in range(len(times))]
    with write_files_atomically(directory, [LIST, *names], overwrite) as place_of:
        place_of(LIST).write_text(_paraview_series_text(names, times), encoding="utf-8")
        frames = iterate_frames(run, bar=directory.name if progress else None)
        for name, frame in zip(names, frames, strict=True):
            meshio.write(place_of(name), _mesh_of_frame(meshio, frame), file_format="vtu")
    return (directory / LIST, *(directory / name for name in names))


def _mesh_of_frame(meshio: Any, frame: Frame) -> Any:
    grains, present = present_grain_indices_and_frame(frame)
    data = {
        "radius": present.diameters / 2.0,
        "mass": present.masses,
        "species": present.species.astype(np.int64),
        "grain": grains.astype(np.int64),
        "velocity": append_zero_z_coordinate(present.velocities),
        "force": append_zero_z_coordinate(present.forces),
    }
    points = np.arange(len(grains))[:, None]
    return meshio.Mesh(append_zero_z_coordinate(present.positions), [("vertex", points)], point_data=data)


def _paraview_series_text(names: list[str], times: np.ndarray) -> str:
    """Return a list of files with their times as XML text, for ParaView."""
    lines = [
        f'    <DataSet timestep="{time:.17g}" file="{name}"/>'
        for name, time in zip(names, times, strict=True)
    ]
    return (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
        + "\n".join(lines)
        + "\n  </Collection>\n</VTKFile>\n"
    )


VTK = Exporter(to_vtk, "VTK files for ParaView")
