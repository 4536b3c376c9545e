"""Command line of the simulation: ``python -m granular``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.shared.console import (
    Parser,
    add_accuracy,
    add_changes,
    add_import,
    add_output,
    add_run,
    add_scene,
    changes_from,
    command_parser,
    emit,
    in_unit,
    launch,
    time_step,
)
from granular.shared.errors import GranularError, InputError
from granular.shared.files import write_text

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene
    from granular.studies.sweep import Study


PROG = "python -m granular"

EXAMPLES = {
    "": """\
a first run, looked at:
  %(prog)s scenes
  %(prog)s show bed
  %(prog)s run bed --t-end 0.5 -o runs/bed
  %(prog)s render runs/bed -o bed.png --colour speed""",
    "scenes": "example:\n  %(prog)s",
    "show": """\
example:
  %(prog)s damper --set piston.mass=6.5""",
    "run": """\
examples:
  %(prog)s bed --t-end 0.5 -o runs/bed
  %(prog)s damper --set piston.mass=6.5 --set 'effects.drag.coefficient=0.2 kg/s'
  %(prog)s damper --accuracy '1e-2 rest height'
  %(prog)s damper -o runs/damper --resume     # goes on after Ctrl-C""",
    "export": """\
examples:
  %(prog)s runs/bed --format gsd -o bed.gsd          # for OVITO
  %(prog)s runs/bed --format extxyz -o bed.xyz       # text, for OVITO and ASE
  %(prog)s runs/bed --format vtk -o vtk              # ParaView: open vtk/bed.pvd
  %(prog)s runs/bed --format csv -o tables           # scalars.csv and grains.csv
  %(prog)s runs/bed --format source -o dat           # posPart.dat and the rest
  %(prog)s bed --format lammps -o deck               # also of a scene""",
    "sweep": """\
example:
  %(prog)s study.toml -o studies/mass      # again: goes on where it was

study.toml:
  scene = "damper"
  dt = "auto*2"
  [grid]                       # all combinations
  "piston.mass" = [6.0, 7.5]
  "arrangement.seed" = [1, 2, 3]
  [[cases]]                    # and one by one
  "piston.mass" = "9 kg" """,
    "observe": """\
examples:
  %(prog)s runs/bed mean_distance hexatic_order -o order.csv
  %(prog)s runs/bed greatest_force --import mine.py

observables:
  mean_distance     mean distance of two grains
  piston_distance   distance of the piston from the grain next to it
  packing           packing fraction below the piston
  hexatic_order     mean of |psi_6| over the grains
  temperature       kinetic temperature of the bed

mine.py:
  import numpy as np
  from granular.observables import observable

  @observable("N", "greatest force on a grain")
  def greatest_force(frame):
      return np.nanmax(np.linalg.norm(frame.forces, axis=1))""",
    "warm-up": """\
examples:
  %(prog)s                    (all packaged scenes; for images and continuous integration)
  %(prog)s damper my-bed.toml --set effects.friction=true""",
    "render": """\
examples:
  %(prog)s runs/bed -o bed.png --colour force
  %(prog)s runs/bed -o start.svg --frame 0
  %(prog)s runs/bed -o bed.mp4 --colour sides --stage settle --fps 30

colours:
  species       which species a grain is of
  speed         of each grain
  force         magnitude of the force of grains and walls on each grain
  sides         number of sides of the Voronoi cells, drawn
  regularity    of the hexagonal Voronoi cells: 1 for a regular hexagon
  fluctuation   |F - mean|/mean of the force, within the species""",
}


def parser(prog: str = PROG) -> Parser:
    """The command line's grammar; ``prog`` is what the user types before a command."""
    top, add = command_parser(
        prog, "Simulate beds of repelling magnets and the piston on them.", EXAMPLES
    )
    add_output(add("scenes", "list the packaged scenes"))
    one = add("show", "tell what a scene holds, in SI and in natural units")
    add_scene(one)
    add_import(one)
    add_output(one)
    one = add("run", "run a scene")
    add_scene(one)
    one.add_argument("-o", "--out", metavar="DIR", help="directory to write the run to")
    one.add_argument(
        "--t-end", type=in_unit("s"), metavar="T", help="stop at this time, as 0.5 or '500 ms'"
    )
    one.add_argument("--resume", action="store_true", help="go on with the run in DIR")
    add_run(one)
    add_accuracy(one)
    add_output(one)
    _add_observe(add("observe", "observables of every frame of a run, as a table"))
    _add_export(add("export", "write a run for other programs"))
    _add_render(add("render", "draw a still or a movie of a run"))
    _add_sweep(add("sweep", "run a scene under many changes, from a study's file"))
    _add_warm_up(add("warm-up", "compile what scenes need, once and for all later starts"))
    return top


def _add_warm_up(one: Parser) -> None:
    one.add_argument(
        "scenes", metavar="SCENE", nargs="*", help="names or TOML files (all packaged scenes)"
    )
    add_changes(one)
    add_import(one)
    add_output(one)


def _add_sweep(one: Parser) -> None:
    one.add_argument("study", metavar="STUDY", help="the study's TOML file")
    one.add_argument(
        "-o", "--out", metavar="DIR", required=True, help="directory that keeps what is done"
    )
    one.add_argument("--workers", type=int, metavar="N", help="processes on this machine")
    one.add_argument("--dask", metavar="ADDRESS", help="run on the Dask cluster at this address")
    one.add_argument("--mpi", action="store_true", help="run on the ranks of mpi4py.futures")
    one.add_argument("--keep-runs", action="store_true", help="keep the whole runs too")
    add_import(one)
    add_output(one)


def _add_observe(one: Parser) -> None:
    one.add_argument("run", metavar="RUN", help="directory that a run was written to")
    one.add_argument(
        "names", metavar="NAME", nargs="+", help="of an observable; see below, or your own"
    )
    add_import(one)
    one.add_argument("-o", "--out", metavar="FILE", help="write the table to this CSV file")
    add_output(one)


def _add_export(one: Parser) -> None:
    add_scene(one, "run", "directory that a run was written to; for 'lammps' also a scene")
    one.add_argument(
        "--format",
        required=True,
        choices=("gsd", "extxyz", "vtk", "csv", "parquet", "source", "lammps"),
        help="GSD, extended XYZ, VTK files for ParaView, tables, the .dat files of the source's "
        "program, or a LAMMPS input deck",
    )
    one.add_argument(
        "-o", "--out", metavar="PATH", required=True,
        help="file; a directory for all but 'gsd' and 'extxyz'",
    )  # fmt: skip
    one.add_argument("--dt", help="longest time step of the LAMMPS deck [s], or such as auto/2")
    one.add_argument("--force", action="store_true", help="replace what is there")
    add_import(one)
    add_output(one)


def _add_render(one: Parser) -> None:
    one.add_argument("run", metavar="RUN", help="directory that a run was written to")
    one.add_argument(
        "-o",
        "--out",
        metavar="FILE",
        required=True,
        help="a still (.png, .svg, .pdf) or a movie (.mp4, .gif)",
    )
    one.add_argument("--colour", default="species", help="what the colours show; see below")
    one.add_argument(
        "--frame", type=int, metavar="N", help="number of the still's frame, -1 for the last"
    )
    one.add_argument("--time", metavar="T", help="take the frame nearest to this time [s]")
    one.add_argument("--stage", metavar="NAME", help="the movie shows this stage only")
    one.add_argument("--fps", type=float, metavar="F", help="the movie's frames a second (25)")
    one.add_argument("--force", action="store_true", help="replace the file if it is there")
    add_import(one)
    add_output(one)


def main(arguments: Sequence[str], prog: str = PROG) -> None:
    """Run one command."""
    options = parser(prog).parse_args(arguments)
    commands = {
        "scenes": _scenes, "show": _show, "run": _run, "export": _export, "render": _render,
        "sweep": _sweep, "observe": _observe, "warm-up": _warm_up,
    }  # fmt: skip
    commands[options.command](options)


def _scene(options: Any) -> Scene:
    from granular.scene.loading import load_scene

    return load_scene(options.scene).replace(**changes_from(options.changes))


def _scenes(options: Any) -> None:
    from granular.effects.registry import names
    from granular.methods.named import GROUP as METHOD_GROUP
    from granular.methods.tables import METHODS
    from granular.observables.named import GROUP as OBSERVABLE_GROUP
    from granular.observables.named import OBSERVABLES
    from granular.scene.loading import SCENES, scene_names
    from granular.shared.offered import names_offered

    first = {}
    for name in scene_names():
        lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
        comment = [line[1:].strip() for line in lines if line.startswith("#")]
        first[name] = " ".join(comment)
    width = max(map(len, first))
    lines = [f"{name:{width}}  {text}" for name, text in first.items()]
    known = {
        "effects": names(),
        "methods": (*METHODS, *names_offered(METHOD_GROUP)),
        "observables": (*OBSERVABLES, *names_offered(OBSERVABLE_GROUP)),
    }
    more = [f"{what}: {', '.join(some)}" for what, some in known.items()]
    emit(first, "\n".join([*lines, "", *more]), options.json)


def _show(options: Any) -> None:
    from granular.own import import_own
    from granular.run.summary import scene_figures, scene_text

    import_own(options.own_files)
    scene = _scene(options)
    emit(
        {"scene": scene.to_plain(), "figures": scene_figures(scene)},
        scene_text(scene),
        options.json,
    )


def _run(options: Any) -> None:
    from granular.own import import_own
    from granular.run.simulation import simulate

    import_own(options.own_files)
    run = simulate(
        _scene(options),
        dt=time_step(options.dt),
        t_end=options.t_end,
        method=options.method,
        out=options.out,
        resume=options.resume,
        threads=options.threads,
        progress=not options.quiet,
        accuracy=options.accuracy,
    )
    emit(*_outcome(run), options.json)


def _outcome(run: Trajectory) -> tuple[dict[str, Any], str]:
    from granular.run.price import price_text
    from granular.run.summary import run_figures, run_text

    figures = run_figures(run) | {"price": price_text(run)}
    lines = [run_text(run)]
    if run.path is None:
        lines.append("nothing is kept of the run; -o DIR keeps it")
    if "accuracy" in figures:
        lines.append(f"chosen for {figures['accuracy']}")
    return figures, "\n".join([*lines, figures["price"]])


def _observe(options: Any) -> None:
    from granular.observables.named import observable_named
    from granular.observables.table import observed_table
    from granular.own import import_own
    from granular.run.trajectory import load_trajectory

    own = import_own(options.own_files).observables
    run = load_trajectory(options.run)
    table = observed_table(run, [observable_named(name, own) for name in options.names])
    if options.out is not None:
        write_text(Path(options.out), table.to_csv(index=False))
    text = table.to_string(index=False) if options.out is None else f"written to {options.out}"
    emit({"table": table.to_dict("list"), "out": options.out}, text, options.json)


def _export(options: Any) -> None:
    from granular.own import import_own

    import_own(options.own_files)
    if options.format == "lammps":
        _export_deck(options)
    else:
        _export_frames(options)


def _export_deck(options: Any) -> None:
    from granular.export import to_lammps
    from granular.run.directory import is_run

    at_run = is_run(Path(options.run))
    if at_run and options.changes:
        raise InputError(f"--set changes a scene; {options.run} is a run, whose scene is fixed")
    options.scene = options.run
    files = to_lammps(
        options.run if at_run else _scene(options),
        options.out,
        dt=time_step(options.dt or "auto"),
        overwrite=options.force,
    )
    text = f"LAMMPS deck written to {options.out}; there: mpirun -np 2 lmp -in in.granular"
    emit({"format": "lammps", "files": [str(one) for one in files]}, text, options.json)


def _export_frames(options: Any) -> None:
    from granular.export import to_extxyz, to_gsd, to_source_files, to_tables, to_vtk
    from granular.run.trajectory import load_trajectory

    if options.changes or options.dt:
        raise InputError("--set and --dt are for --format lammps; leave them out")
    run, progress = load_trajectory(options.run), not options.quiet
    writers: dict[str, Any] = {
        "gsd": to_gsd, "extxyz": to_extxyz, "vtk": to_vtk, "source": to_source_files,
        "csv": to_tables, "parquet": partial(to_tables, kind="parquet"),
    }  # fmt: skip
    write = writers[options.format]
    found = write(run, options.out, overwrite=options.force, progress=progress)
    files = found if isinstance(found, tuple) else (found,)
    frames = run.dataset.sizes["frame"]
    names = [str(one) for one in files]
    text = f"{frames} frames written to {options.out}"
    emit({"format": options.format, "frames": frames, "files": names}, text, options.json)


def _render(options: Any) -> None:
    from granular.own import import_own
    from granular.render import WRITERS

    import_own(options.own_files)
    if Path(options.out).suffix.lower() in WRITERS:
        _render_movie(options)
    else:
        _render_still(options)


def _render_still(options: Any) -> None:
    from granular.render import save, still
    from granular.scene.units import si_value

    if options.stage is not None or options.fps is not None:
        raise InputError(
            "--stage and --fps are for movies (-o bed.mp4); choose a still's frame with --frame or "
            "--time"
        )
    if options.frame is not None and options.time is not None:
        raise InputError("--frame and --time name two frames; give one of them")
    time = None if options.time is None else si_value(options.time, "s")
    number = -1 if options.frame is None else options.frame
    figure = still(options.run, number, time=time, colour=options.colour)
    path = save(figure, options.out, overwrite=options.force)
    emit({"file": str(path), "colour": options.colour}, f"drawn to {path}", options.json)


def _render_movie(options: Any) -> None:
    from granular.render import movie

    if options.frame is not None or options.time is not None:
        raise InputError("--frame and --time are for stills; choose a movie's part with --stage")
    path = movie(
        options.run,
        options.out,
        colour=options.colour,
        fps=25.0 if options.fps is None else options.fps,
        stage=options.stage,
        overwrite=options.force,
        progress=not options.quiet,
    )
    emit({"file": str(path), "colour": options.colour}, f"drawn to {path}", options.json)


def _warm_up(options: Any) -> None:
    from granular.compiled.cache import cache_folder
    from granular.own import import_own
    from granular.run.warm_up import warm_up
    from granular.scene.loading import load_scene, scene_names

    import_own(options.own_files)
    changes = changes_from(options.changes)
    scenes = [load_scene(name).replace(**changes) for name in options.scenes or scene_names()]
    seconds = warm_up(scenes)
    folder = cache_folder()
    if folder is None:
        raise InputError(
            "there is no folder to keep compiled code in; name one of your own in NUMBA_CACHE_DIR"
        )
    lines = [f"{name}: {time:.1f} s" for name, time in seconds.items()]
    emit(
        {"seconds": seconds, "folder": str(folder)},
        "\n".join([*lines, f"compiled code is in {folder}"]),
        options.json,
    )


def _sweep(options: Any) -> None:
    from granular.own import import_own
    from granular.studies.file import load_study
    from granular.studies.remote import executor
    from granular.studies.sweep import sweep

    study = load_study(options.study, import_own(options.own_files).measures)
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give at least 1")
    with executor(options.dask, options.mpi) as pool:
        found = sweep(
            study.pop("scene"),
            out=options.out,
            keep_runs=options.keep_runs,
            executor=pool,
            workers=options.workers,
            progress=not options.quiet,
            **study,
        )
    path = Path(options.out) / "table.csv"
    write_text(path, found.table.to_csv(index=False))
    figures = {
        "cases": len(found.cases),
        "reused": found.reused,
        "failed": len(found.failed),
        "unfinished": len(found.unfinished),
        "table": str(path),
    }
    text = (
        f"{len(found.cases)} cases, {found.reused} of them done before, {len(found.failed)} "
        f"failed; table in {path}"
    )
    emit(figures, text, options.json)
    if found.unfinished:
        raise GranularError(_told(found))


def _told(study: Study) -> str:
    errors = [outcome["error"] for outcome in study.outcomes if "cause" in outcome]
    return (
        f"{len(errors)} of {len(study.cases)} cases could not be computed, the first because of "
        f"{errors[0]}; mend that, and the same command goes on with them"
    )


if __name__ == "__main__":
    sys.exit(launch(main))
