"""Further runs of a scene that show what the time step and the random start do to a figure.

Each run is a process of its own (``python -m reduced_models.identification.checks``), so that they
go side by side whatever the calling program looks like, and one that fails takes nothing with it.
"""

from __future__ import annotations

import concurrent.futures
import io
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

CHECK_SEEDS = 2
"""Further random starts of the bed that are run to see the scatter."""
_RESOLVED = 1.0  # step times highest frequency up to which a method shows its order; half the limit
_FAILED = 1


class Case(NamedTuple):
    """A run to make.

    Attributes
    ----------
    what : str
        In words, for messages.
    scene : dict
        As plain data.
    dt : float or str
    method : str
    t_end : float or None
        [s]
    """

    what: str
    scene: dict[str, Any]
    dt: float | str
    method: str
    t_end: float | None


class Failure(NamedTuple):
    """Why a check has no record."""

    what: str
    cause: str


def halved(dt: float | str) -> float | str:
    """Half a time step, given in seconds or as a multiple of the automatic one."""
    return _scaled(dt, 0.5)


def doubled(dt: float | str) -> float | str:
    """Twice a time step, given in the same ways."""
    return _scaled(dt, 2.0)


def _scaled(dt: float | str, by: float) -> float | str:
    from granular.run.simulation import checked_step

    step = checked_step(dt)
    if step.seconds is not None:
        return by * step.seconds
    factor = by * step.factor
    if factor >= 1.0:
        return f"auto*{_positional(factor)}"
    return f"auto/{_positional(1.0 / factor)}"


def _positional(value: float) -> str:
    return np.format_float_positional(value, trim="-")


class StepCheck(NamedTuple):
    """A run with another time step.

    Attributes
    ----------
    case : Case
    factor : float
        Error of the step that was used, over what the other one changes.
    """

    case: Case
    factor: float


def step_check(run: Trajectory) -> StepCheck:
    """The scene of a run with twice its time step, or half of it where twice is too coarse.

    A method of order p is off by 1/(2^p - 1) of what twice the step changes; all of the change is
    taken for the error, which it bounds also where a bed that packs otherwise follows no order.
    Half the step changes 1 - 2^-p of the error.
    """
    from granular.methods import method_named

    settings = run.settings()
    coarser = 2.0 * settings["step_times_highest_frequency"]
    if coarser <= _RESOLVED and _allowed(run.scene, doubled(settings["dt"])):
        return StepCheck(_step_case(run, "twice the time step", doubled(settings["dt"])), 1.0)
    power = 2.0 ** method_named(settings["method"]).order
    case = _step_case(run, "half the time step", halved(settings["dt"]))
    return StepCheck(case, power / (power - 1.0))


def _allowed(scene: Scene, dt: float | str) -> bool:
    from granular.run.simulation import checked_step

    try:
        checked_step(dt, scene)
    except InputError:
        return False
    return True


def _step_case(run: Trajectory, what: str, dt: float | str) -> Case:
    return Case(what, run.scene.to_plain(), dt, run.settings()["method"], _forced_end(run))


def seed_cases(run: Trajectory) -> list[Case]:
    """The scene of a run from other random starts, all else alike."""
    settings, first = run.settings(), run.scene.arrangement.seed + 1
    return [
        Case(
            f"random start {seed}",
            run.scene.replace(**{"arrangement.seed": seed}).to_plain(),
            settings["dt"],
            settings["method"],
            _forced_end(run),
        )
        for seed in range(first, first + CHECK_SEEDS)
    ]


def _forced_end(run: Trajectory) -> float | None:
    """End of a run whose last stage has no end of its own."""
    height = 1.0 if run.scene.piston is None else run.scene.piston.height
    if run.scene.protocol[-1].span(height) is not None:
        return None
    return float(run.dataset["time"].values[-1])


def run_cases(cases: Sequence[Case], progress: bool) -> list[PistonRecord | Failure]:
    """Records of some cases, or why there is none, in their order."""
    from tqdm import tqdm

    children: list[subprocess.Popen[bytes]] = []
    workers = min(len(cases), os.cpu_count() or 1)
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(_outcome, case, children) for case in cases]
        try:
            for _ in tqdm(
                concurrent.futures.as_completed(jobs),
                total=len(jobs),
                desc="checks of step and seeds",
                disable=not progress,
                file=sys.stderr,
            ):
                pass
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in children:
                child.terminate()
            raise
    return [job.result() for job in jobs]


def _outcome(case: Case, children: list[subprocess.Popen[bytes]]) -> PistonRecord | Failure:
    """Run one case in a process of its own."""
    home = str(Path(__file__).parents[2])
    paths = os.pathsep.join(filter(None, (home, os.environ.get("PYTHONPATH"))))
    child = subprocess.Popen(
        [sys.executable, "-m", "reduced_models.identification.checks"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": paths},
    )
    children.append(child)
    output, complaint = child.communicate(json.dumps(case).encode())
    if child.returncode != 0:
        words = complaint.decode(errors="replace").strip().splitlines()
        return Failure(case.what, words[-1] if words else f"exit code {child.returncode}")
    columns = np.load(io.BytesIO(output), allow_pickle=False)
    return PistonRecord(columns[0], columns[1])


def main() -> int:
    """Run the case on standard input; its record goes to standard output."""
    from granular.run.simulation import simulate
    from granular.scene.scene import Scene

    warnings.simplefilter("ignore")  # the main run has said what there is to say
    case = Case(*json.load(sys.stdin))
    try:
        run = simulate(
            Scene.from_plain(case.scene),
            dt=case.dt,
            t_end=case.t_end,
            method=case.method,
            threads=1,
            progress=False,
        )
        record = run.piston()
    except GranularError as error:
        print(f"{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        return _FAILED
    np.save(sys.stdout.buffer, np.stack([record.time, record.height]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
