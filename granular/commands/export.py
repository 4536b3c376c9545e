"""The command ``export``: a run for other programs."""

from __future__ import annotations

from functools import partial
from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import CHANGES, IMPORT, OUTPUT, parse_time_step, scene_or_run_from_options
from granular.shared.errors import InputError


@command(
    "export",
    "write a run for other programs",
    option("run", metavar="RUN", help="directory that a run was written to; for 'lammps' also a scene"),
    CHANGES,
    option(
        "--format",
        required=True,
        choices=("gsd", "extxyz", "vtk", "csv", "parquet", "source", "lammps"),
        help="GSD, extended XYZ, VTK files for ParaView, tables, the .dat files of de Paula's "
        "program, or a LAMMPS input deck",
    ),
    option(
        "-o", "--out", metavar="PATH", required=True, help="file; a directory for all but 'gsd' and 'extxyz'"
    ),
    option("--dt", help="longest time step of the LAMMPS deck [s], or such as auto/2"),
    option("--force", action="store_true", help="replace what is there"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s runs/bed --format gsd -o bed.gsd          # for OVITO
  %(prog)s runs/bed --format extxyz -o bed.xyz       # text, for OVITO and ASE
  %(prog)s runs/bed --format vtk -o vtk              # ParaView: open vtk/bed.pvd
  %(prog)s runs/bed --format csv -o tables           # scalars.csv and grains.csv
  %(prog)s runs/bed --format source -o dat           # posPart.dat and the rest
  %(prog)s bed --format lammps -o deck               # also of a scene""",
)
def export(options: Any) -> None:
    """Write a run in a format of other programs, or a LAMMPS deck of a scene or run."""
    from granular.user_code import import_user_code

    import_user_code(options.user_files)
    if options.format == "lammps":
        _export_lammps_deck(options)
    else:
        _export_frames(options)


def _export_lammps_deck(options: Any) -> None:
    from granular.export import to_lammps

    files = to_lammps(
        scene_or_run_from_options(options, options.run),
        options.out,
        dt=parse_time_step(options.dt or "auto"),
        overwrite=options.force,
    )
    text = f"LAMMPS deck written to {options.out}; there: mpirun -np 2 lmp -in in.granular"
    print_result({"format": "lammps", "files": [str(file) for file in files]}, text, options.json)


def _export_frames(options: Any) -> None:
    from granular.export import to_depaula_files, to_extxyz, to_gsd, to_tables, to_vtk
    from granular.run.trajectory import load_trajectory

    if options.changes or options.dt:
        raise InputError("--set and --dt are for --format lammps; leave them out")
    run, progress = load_trajectory(options.run), not options.quiet
    writers: dict[str, Any] = {
        "gsd": to_gsd,
        "extxyz": to_extxyz,
        "vtk": to_vtk,
        "source": to_depaula_files,
        "csv": to_tables,
        "parquet": partial(to_tables, kind="parquet"),
    }
    write = writers[options.format]
    result = write(run, options.out, overwrite=options.force, progress=progress)
    files = result if isinstance(result, tuple) else (result,)
    frames = run.dataset.sizes["frame"]
    names = [str(file) for file in files]
    text = f"{frames} frames written to {options.out}"
    print_result({"format": options.format, "frames": frames, "files": names}, text, options.json)
