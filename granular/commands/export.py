"""The command ``export``: a run for other programs."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

from granular.commands.console import command, print_result
from granular.commands.options import Changes, Output, TimeStep
from granular.commands.signature import Option
from granular.shared.errors import InputError


@command("""\
examples:
  %(prog)s runs/bed --format gsd -o bed.gsd          # for OVITO
  %(prog)s runs/bed --format extxyz -o bed.xyz       # text, for OVITO and ASE
  %(prog)s runs/bed --format vtk -o vtk              # ParaView: open vtk/bed.pvd
  %(prog)s runs/bed --format csv -o tables           # scalars.csv and grains.csv
  %(prog)s runs/bed --format source -o dat           # posPart.dat and the rest
  %(prog)s bed --format lammps -o deck               # also of a scene""")
def export(
    run: Annotated[str, Option("directory that a run was written to; for 'lammps' also a scene", "RUN")],
    *,
    changes: Changes,
    kind: Annotated[
        Literal["gsd", "extxyz", "vtk", "csv", "parquet", "source", "lammps"],
        Option(
            "GSD, extended XYZ, VTK files for ParaView, tables, the .dat files of de Paula's program, or a "
            "LAMMPS input deck",
            name="--format",
        ),
    ],
    out: Annotated[str, Option("file; a directory for all but 'gsd' and 'extxyz'", "PATH", "-o")],
    dt: Annotated[
        TimeStep | None, Option("longest time step of the LAMMPS deck [s], or such as auto/2")
    ] = None,
    force: Annotated[bool, Option("replace what is there")] = False,
    output: Output,
) -> None:
    """Write a run for other programs."""
    changes.run()
    if kind == "lammps":
        _export_lammps_deck(run, changes, out, "auto" if dt is None else dt, force, output)
        return
    if changes.changes or dt is not None:
        raise InputError("--set and --dt are for --format lammps; leave them out")
    _export_frames(run, kind, out, force, output)


def _export_lammps_deck(
    run: str, changes: Changes, out: str, dt: float | str, force: bool, output: Output
) -> None:
    from granular.export import to_lammps

    files = to_lammps(changes.load_scene_or_run(run), out, dt=dt, overwrite=force)
    text = f"LAMMPS deck written to {out}; there: mpirun -np 2 lmp -in in.granular"
    print_result({"format": "lammps", "files": [str(file) for file in files]}, text, output.json)


def _export_frames(run: str, kind: str, out: str, force: bool, output: Output) -> None:
    from granular.export import to_depaula_files, to_extxyz, to_gsd, to_tables, to_vtk
    from granular.run.trajectory import load_trajectory

    trajectory = load_trajectory(run)
    writers: dict[str, Any] = {
        "gsd": to_gsd,
        "extxyz": to_extxyz,
        "vtk": to_vtk,
        "source": to_depaula_files,
        "csv": to_tables,
        "parquet": partial(to_tables, kind="parquet"),
    }
    result = writers[kind](trajectory, out, overwrite=force, progress=output.progress)
    files = result if isinstance(result, tuple) else (result,)
    frames = trajectory.dataset.sizes["frame"]
    names = [str(file) for file in files]
    text = f"{frames} frames written to {out}"
    print_result({"format": kind, "frames": frames, "files": names}, text, output.json)
