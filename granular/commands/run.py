"""The commands ``run`` and ``sweep``: run one scene, or run a scene with many changes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from granular.commands.console import command, print_result
from granular.commands.options import (
    Accuracy,
    MethodName,
    OutputOptions,
    SceneChangeOptions,
    SceneName,
    ThreadCount,
    TimeStep,
    UserCodeOptions,
    WorkerCount,
)
from granular.commands.signature import Option, Seconds
from granular.shared.errors import GranularError, InputError
from granular.shared.files import write_text

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


@command("""\
examples:
  %(prog)s bed --t-end 0.5 -o runs/bed
  %(prog)s damper --set piston.mass=6.5 --set 'effects.drag.coefficient=0.2 kg/s'
  %(prog)s damper --accuracy '1e-2 rest height'
  %(prog)s damper -o runs/damper --resume     # continues after Ctrl-C""")
def run(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    out: Annotated[str | None, Option("directory to write the run to", "DIR", "-o")] = None,
    t_end: Annotated[Seconds | None, Option("stop at this time, such as 0.5 or '500 ms'", "T")] = None,
    resume: Annotated[bool, Option("continue the run in DIR")] = False,
    dt: TimeStep = "auto",
    method: MethodName = "stormer-verlet",
    threads: ThreadCount = None,
    accuracy: Accuracy = None,
    engine: Annotated[
        str, Option(("engine that computes the bed: numba, or the name of an installed engine"), "NAME")
    ] = "numba",
    output: OutputOptions,
) -> None:
    """Run a scene."""
    from granular.run.simulation import simulate

    done = simulate(
        changes.load(scene),
        dt=dt,
        t_end=t_end,
        method=method,
        out=out,
        resume=resume,
        threads=threads,
        accuracy=accuracy,
        engine=engine,
        progress=output.shows_progress,
    )
    print_result(*_run_outcome_and_text(done), output.json)


def _run_outcome_and_text(done: Trajectory) -> tuple[dict[str, Any], str]:
    from granular.run.summary import run_statistics, run_text
    from granular.run.work_precision import work_precision_text

    figures = run_statistics(done) | {"price": work_precision_text(done)}
    lines = [run_text(done)]
    if done.path is None:
        lines.append("the run is not stored; -o DIR stores it")
    if "accuracy" in figures:
        lines.append(f"chosen for {figures['accuracy']}")
    return figures, "\n".join([*lines, figures["price"]])


@command("""\
example:
  %(prog)s study.toml -o studies/mass      # repeat to continue

study.toml:
  scene = "damper"
  dt = "auto*2"
  [changes]                    # in every case
  "effects.drag.coefficient" = "0.2 kg/s"
  [grid]                       # all combinations
  "piston.mass" = [6.0, 7.5]
  "arrangement.seed" = [1, 2, 3]
  [[cases]]                    # further single cases
  "piston.mass" = "9 kg" """)
def sweep(
    study: Annotated[str, Option("the study's TOML file", "STUDY")],
    *,
    out: Annotated[str, Option("directory for the results", "DIR", "-o")],
    workers: WorkerCount = None,
    dask: Annotated[str | None, Option("run on the Dask cluster at this address", "ADDRESS")] = None,
    mpi: Annotated[bool, Option("run on MPI ranks, with mpi4py.futures")] = False,
    keep_runs: Annotated[bool, Option("also keep the complete runs")] = False,
    own: UserCodeOptions,
    output: OutputOptions,
) -> None:
    """Run a scene once for each set of changes in a study file."""
    from granular.studies.executors import connect_to_cluster
    from granular.studies.study_page import study_page
    from granular.studies.sweep import load_study
    from granular.studies.sweep import sweep as run_study

    settings = load_study(study, own.import_user_code())
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers} is below the limit; give 1 or more")
    with connect_to_cluster(dask, mpi) as pool:
        done = run_study(
            settings.pop("scene"),
            executor=pool,
            out=out,
            keep_runs=keep_runs,
            workers=workers,
            progress=output.shows_progress,
            **settings,
        )
    path, page = Path(out) / "table.csv", Path(out) / "report.html"
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
    print_result(figures, text, output.json)
    if done.unfinished:
        errors = [outcome.error for outcome in done.outcomes if outcome.cause is not None]
        raise GranularError(
            f"{len(errors)} of {len(done.cases)} cases could not be computed, the first because of "
            f"{errors[0]}; correct this, and repeat the command to compute them"
        )
