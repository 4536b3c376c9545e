"""Runs of the layers, each in a separate directory, from which an interrupted run resumes."""

from __future__ import annotations

from concurrent.futures import as_completed
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.files import ResultCache, digest, make_directory
from granular.studies.executors import given_executor_or_new_processes
from research.melting.scenes import STEP, make_layer


class LayerRunPlan(NamedTuple):
    """Parameters of the runs of a study.

    Attributes
    ----------
    gammas : tuple of float
    columns : int
        Number of columns of the crystal, equal to its number of rows.
    settling, measured : float
        Durations of the run before and during the measurement [s].
    """

    gammas: tuple[float, ...]
    columns: int
    settling: float
    measured: float


FORM = 2
"""Version of the measured figures, to be increased if other figures are computed from the same runs."""

QUICK = LayerRunPlan((40.0, 60.0, 100.0), 16, 10.0, 20.0)
FULL = LayerRunPlan(
    (60.0, 64.0, 66.0, 67.0, 68.0, 68.25, 68.5, 68.75, 69.0, 70.0, 71.0, 72.0, 75.0, 80.0, 100.0),
    64,
    50.0,
    100.0,
)


def run_all_layers(
    plan: LayerRunPlan, directory: Path, *, workers: int = 1, progress: bool = True
) -> list[dict[str, Any]]:
    """Return the figures of every layer, in the plan's order; figures in the directory are reused.

    Parameters
    ----------
    plan : Plan
    directory : Path
    workers : int
        Number of processes.
    progress : bool
        Report the number of finished layers on standard error.

    Raises
    ------
    StoreError
        If the directory cannot be written.
    KeyboardInterrupt
        On Ctrl-C; the runs in the directory can be resumed.
    """
    from granular.shared.progress_bars import progress_bar

    make_directory(directory)
    with (
        given_executor_or_new_processes(None, workers) as pool,
        progress_bar(total=len(plan.gammas), desc="layers", unit="layer", wanted=progress) as bar,
    ):
        waiting = {pool.submit(run_or_resume_layer, plan, item, directory): item for item in plan.gammas}
        outcome = {}
        for done in as_completed(waiting):
            outcome[waiting[done]] = done.result()
            bar.update()
    return [outcome[item] for item in plan.gammas]


def run_or_resume_layer(plan: LayerRunPlan, gamma: float, directory: Path) -> dict[str, Any]:
    """Return the figures of a layer from its run, which is started or resumed if necessary."""
    from granular.run.simulation import simulate
    from research.melting.measures import measure_layer

    item = make_layer(gamma, plan.columns)
    asked = {"scene": item.scene.to_plain(), "plan": plan._asdict() | {"gammas": None}}
    key = digest(asked, 20)
    cache = ResultCache(directory / "layers")
    kept = cache.read(f"{key}-{FORM}")
    if kept is None:
        run = simulate(
            item.scene,
            t_end=plan.settling + plan.measured,
            dt=STEP,
            threads=1,
            out=directory / "runs" / key,
            resume=True,
            progress=False,
        )
        kept = measure_layer(item, run, plan.settling)
        make_directory(cache.directory)
        cache.store(f"{key}-{FORM}", kept)
    return dict(kept)
