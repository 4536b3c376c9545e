"""The study behind the maps: dampers spread over the box, simulated, their figures as a table.

Sobol's sequence fills the box evenly (Sobol 1967, doi:10.1016/0041-5553(67)90144-9); its corners
are added, so that the maps are not continued beyond what was simulated.
"""

from __future__ import annotations

import itertools
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from granular.scene.beds import damper
from granular.shared.errors import InputError
from granular.studies.sweep import sweep
from reduced_models.designs.candidate import Candidate, candidate_at
from reduced_models.designs.figures import damper_figures

if TYPE_CHECKING:
    import pandas

POINTS = 128
"""Of the sequence, beside the sixteen corners."""
COMMITTED = Path(__file__).parent / "study.csv"
"""The study that comes with the package. ``python -m reduced_models design --maps --simulate -o
DIR`` makes it anew."""
STEP = "auto*2"
"""Rest height, period and damping of the published damper are the same at half of it, to four
digits."""


def design_points(count: int = POINTS) -> list[Candidate]:
    """The dampers of a study: corners of the box, and ``count`` points of Sobol's sequence."""
    from scipy.stats import qmc

    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
    inside = 2.0 * qmc.Sobol(4, scramble=True, seed=1).random(count) - 1.0
    # Small beds first: they say soonest whether something is wrong.
    places = sorted(np.vstack([corners, inside]), key=lambda place: place[1])
    return [candidate_at(place) for place in places]


def run_study(
    out: str | Path | None = None,
    *,
    points: int = POINTS,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> pandas.DataFrame:
    """Simulate the dampers of a study.

    Parameters
    ----------
    out : str or Path, optional
        Directory that keeps every case as soon as it is done; called again, the study goes on.
    points : int
        Of Sobol's sequence, a power of two.
    executor, workers
        As in `granular.sweep`.
    progress : bool

    Returns
    -------
    DataFrame
        One row a damper: ``mass`` [kg], ``grains``, ``drag`` [kg/s], ``small_share``, the figures
        of `damper_figures`, and ``error`` where its run failed.

    Raises
    ------
    InputError
        If ``points`` is no power of two from 64 on: fewer do not make maps.
    """
    import pandas

    if points < 64 or points & (points - 1):
        raise InputError(f"points = {points}; give a power of two from 64 on, such as {POINTS}")
    dampers = design_points(points)
    study = sweep(
        damper(),
        cases=[one.scene().to_plain() for one in dampers],
        measure=damper_figures,
        dt=STEP,
        out=out,
        executor=executor,
        workers=workers,
        progress=progress,
    )
    rows = [
        one._asdict() | dict(outcome["figures"]) | {"error": outcome["error"] or ""}
        for one, outcome in zip(dampers, study.outcomes, strict=True)
    ]
    return pandas.DataFrame(rows)
