"""The commands ``run`` and ``sweep``: one scene, and a scene under many changes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import command, option, pick_options, print_result
from granular.commands.options import (
    ACCURACY,
    CHANGES,
    DT,
    ENGINE,
    IMPORT,
    METHOD,
    OUTPUT,
    SCENE,
    THREADS,
    WORKERS,
    parse_time_step,
    quantity_reader,
    scene_from_options,
)
from granular.shared.errors import GranularError, InputError
from granular.shared.files import write_text

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


@command(
    "run",
    "run a scene",
    SCENE,
    CHANGES,
    option("-o", "--out", metavar="DIR", help="directory to write the run to"),
    option("--t-end", type=quantity_reader("s"), metavar="T", help="stop at this time, as 0.5 or '500 ms'"),
    option("--resume", action="store_true", help="go on with the run in DIR"),
    DT,
    METHOD,
    IMPORT,
    THREADS,
    ACCURACY,
    ENGINE,
    OUTPUT,
    examples="""\
examples:
  %(prog)s bed --t-end 0.5 -o runs/bed
  %(prog)s damper --set piston.mass=6.5 --set 'effects.drag.coefficient=0.2 kg/s'
  %(prog)s damper --accuracy '1e-2 rest height'
  %(prog)s damper -o runs/damper --resume     # goes on after Ctrl-C""",
)
def run(options: Any) -> None:
    """Run a scene, and print its outcome."""
    from granular.run.simulation import simulate

    done = simulate(
        scene_from_options(options),
        dt=parse_time_step(options.dt),
        progress=not options.quiet,
        **pick_options(options, "t_end", "method", "out", "resume", "threads", "accuracy", "engine"),
    )
    print_result(*_run_outcome_text(done), options.json)


def _run_outcome_text(done: Trajectory) -> tuple[dict[str, Any], str]:
    from granular.run.summary import run_statistics, run_text
    from granular.run.work_precision import work_precision_text

    figures = run_statistics(done) | {"price": work_precision_text(done)}
    lines = [run_text(done)]
    if done.path is None:
        lines.append("nothing is kept of the run; -o DIR keeps it")
    if "accuracy" in figures:
        lines.append(f"chosen for {figures['accuracy']}")
    return figures, "\n".join([*lines, figures["price"]])


@command(
    "sweep",
    "run a scene under many changes, from a study's file",
    option("study", metavar="STUDY", help="the study's TOML file"),
    option("-o", "--out", metavar="DIR", required=True, help="directory that keeps what is done"),
    WORKERS,
    option("--dask", metavar="ADDRESS", help="run on the Dask cluster at this address"),
    option("--mpi", action="store_true", help="run on the ranks of mpi4py.futures"),
    option("--keep-runs", action="store_true", help="keep the whole runs too"),
    IMPORT,
    OUTPUT,
    examples="""\
example:
  %(prog)s study.toml -o studies/mass      # again: goes on where it was

study.toml:
  scene = "damper"
  dt = "auto*2"
  [changes]                    # in every case
  "effects.drag.coefficient" = "0.2 kg/s"
  [grid]                       # all combinations
  "piston.mass" = [6.0, 7.5]
  "arrangement.seed" = [1, 2, 3]
  [[cases]]                    # and one by one
  "piston.mass" = "9 kg" """,
)
def sweep(options: Any) -> None:
    """Run a study, a scene under many changes, and write its table and report."""
    from granular.studies.executors import cluster_executor
    from granular.studies.study_page import study_page
    from granular.studies.sweep import load_study
    from granular.studies.sweep import sweep as run_study
    from granular.user_code import import_user_code

    study = load_study(options.study, import_user_code(options.user_files).measures)
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give at least 1")
    with cluster_executor(options.dask, options.mpi) as pool:
        done = run_study(
            study.pop("scene"),
            executor=pool,
            progress=not options.quiet,
            **pick_options(options, "out", "keep_runs", "workers"),
            **study,
        )
    path, page = Path(options.out) / "table.csv", Path(options.out) / "report.html"
    write_text(path, done.to_csv())
    study_page(done).save(page)
    figures = {
        "cases": len(done.cases),
        "reused": done.reused,
        "failed": len(done.failed),
        "unfinished": len(done.unfinished),
        "table": str(path),
        "report": str(page),
    }
    text = (
        f"{len(done.cases)} cases, {done.reused} of them done before, {len(done.failed)} "
        f"failed; table in {path}, pictures in {page}"
    )
    print_result(figures, text, options.json)
    if done.unfinished:
        errors = [outcome.error for outcome in done.outcomes if outcome.cause is not None]
        raise GranularError(
            f"{len(errors)} of {len(done.cases)} cases could not be computed, the first because of "
            f"{errors[0]}; correct that, and the same command goes on with them"
        )
