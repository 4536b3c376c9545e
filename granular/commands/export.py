"""The command ``export``: convert a run for other programs."""

from __future__ import annotations

from typing import Annotated

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions, SceneChangeOptions, TimeStep
from granular.commands.signature import Option
from granular.export.exporter import EXPORTERS
from granular.shared.errors import InputError


@command("""\
examples:
  %(prog)s runs/bed --format gsd -o bed.gsd          # for OVITO
  %(prog)s runs/bed --format extxyz -o bed.xyz       # text, for OVITO and ASE
  %(prog)s runs/bed --format vtk -o vtk              # ParaView: open vtk/bed.pvd
  %(prog)s runs/bed --format csv -o tables           # scalars.csv and grains.csv
  %(prog)s bed --format lammps -o deck               # a scene or a run""")
def export(
    run: Annotated[str, Option("directory of a run; for 'lammps' also a scene", "RUN")],
    *,
    changes: SceneChangeOptions,
    kind: Annotated[
        str,
        EXPORTERS,
        Option(
            "GSD, extended XYZ, VTK files for ParaView, tables, or a LAMMPS input deck; installed packages "
            "may add more",
            name="--format",
        ),
    ],
    out: Annotated[str, Option("file for 'gsd' and 'extxyz', otherwise a directory", "PATH", "-o")],
    dt: Annotated[
        TimeStep | None,
        Option(
            "maximum time step of the LAMMPS deck [s], or a multiple of the automatic step such as auto/2"
        ),
    ] = None,
    force: Annotated[bool, Option("replace existing files")] = False,
    output: OutputOptions,
) -> None:
    """Write a run for other programs."""
    from granular.run.trajectory import load_trajectory

    changes.import_user_code()
    exporter = EXPORTERS.find(kind)
    if exporter.of_scenes:
        step = "auto" if dt is None else dt
        result = exporter.write(changes.load_scene_or_run(run), out, dt=step, overwrite=force)
        figures, text = {}, f"{exporter.contents} written to {out}"
    elif changes.changes or dt is not None:
        raise InputError(
            "--set and --dt apply only to formats that export scenes, such as lammps; remove these options"
        )
    else:
        trajectory = load_trajectory(run)
        result = exporter.write(trajectory, out, overwrite=force, progress=output.shows_progress)
        figures = {"frames": trajectory.dataset.sizes["frame"]}
        text = f"{figures['frames']} frames written to {out}"
    if exporter.next_step:
        text += f"; {exporter.next_step}"
    files = [str(file) for file in (result if isinstance(result, tuple) else (result,))]
    print_result({"format": kind, **figures, "files": files}, text, output.json)
