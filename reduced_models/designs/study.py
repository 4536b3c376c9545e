"""The study behind the maps: dampers spread over the box, simulated, their figures as a table.

Sobol's sequence fills the box evenly (Sobol 1967, doi:10.1016/0041-5553(67)90144-9); its corners
are added, so that the maps are not continued beyond what was simulated.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.linear.equilibrium import equilibrium_from
from granular.run.piston_record import PistonRecord
from granular.run.trajectory import Trajectory
from granular.scene.published_beds import damper
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from granular.studies.cases import keep_measure_name
from granular.studies.sweep import sweep
from reduced_models.designs.damper import DamperCandidate, damper_at_coordinates
from reduced_models.falls.workshop_sheet import slopes_by_part

if TYPE_CHECKING:
    import pandas

POINTS = 128
"""Points of the sequence, besides the sixteen corners."""
COMMITTED = Path(__file__).parent / "study.csv"
"""The study that comes with the package. ``granular-damper design --maps --simulate -o
DIR`` makes it anew."""
STEP = "auto*2"
"""Rest height, period and damping of the published damper are the same at half of it, to four
digits."""


def design_points(count: int = POINTS) -> list[DamperCandidate]:
    """Dampers of a study: corners of the box, and ``count`` points of Sobol's sequence."""
    from scipy.stats import qmc

    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
    inside = 2.0 * qmc.Sobol(4, scramble=True, seed=1).random(count) - 1.0
    # Small beds first: they say soonest whether something is wrong.
    positions = sorted(np.vstack([corners, inside]), key=lambda coordinates: coordinates[1])
    return [damper_at_coordinates(coordinates) for coordinates in positions]


def run_design_study(
    out: str | Path | None = None,
    *,
    points: int = POINTS,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> pandas.DataFrame:
    """Simulate dampers of dipoles spread over the box of the maps.

    They are the corners of the box, and points of Sobol's sequence (1967,
    doi:10.1016/0041-5553(67)90144-9), scrambled by a fixed seed.

    Parameters
    ----------
    out : str or Path, optional
        Directory that keeps every case as soon as it is done; called again, the study goes on.
        Nothing is kept if not given.
    points : int
        Number of points of Sobol's sequence, a power of two from 64 on; the sixteen corners of the
        box are added.
    executor : concurrent.futures.Executor, optional
        Where the cases run, as in `granular.sweep`.
    workers : int, optional
        Number of processes, from 1 on; as many as there are processors if not given.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    DataFrame
        One row a damper, 16 and ``points`` of them, those with few grains first: ``mass`` [kg],
        ``grains``, ``drag`` [kg/s], ``small_share``, ``magnets``; ``rest_height`` [m]; the law of
        the swing, ``frequency`` [Hz] of the undamped one, ``damping_ratio``, ``lam`` [1/s], ``k1``
        [1/s^2], ``k2`` [1/(m s^2)], ``k3`` [1/(m^2 s^2)], and its rms error over the rms swing,
        ``misfit``; the least distance of two grains at rest over that of their contact,
        ``rest_gap``, and in the whole run over the large diameter, ``fall_gap``; the energy that
        the simulation's ledger lacks, a fraction, ``ledger``; and ``error``: why its run failed,
        else empty. The figures of a run that failed are NaN, and ``frequency`` and
        ``damping_ratio`` where the law has no small swing.

    Raises
    ------
    InputError
        If ``points`` is no power of two from 64 on (fewer do not make maps), or ``workers`` no
        integer from 1 on.
    StoreError
        If ``out`` cannot be made or written to.
    ExecutorLostError
        If the executor's processes are gone; what is done is kept in ``out``.
    KeyboardInterrupt
        On Ctrl-C; ``out`` keeps what was done.

    Warns
    -----
    UserWarning
        Once, if runs warned: the cases and their warnings, as `granular.sweep` does.
    """
    import pandas

    if not isinstance(points, int) or points < 64 or points & (points - 1):
        raise InputError(f"points = {quote(points)}; give a power of two from 64 on, such as {POINTS}")
    check_workers(workers)
    dampers = design_points(points)
    study = sweep(
        damper(),
        cases=[damper_.scene().to_plain() for damper_ in dampers],
        measure=measure_damper_figures,
        dt=STEP,
        out=out,
        executor=executor,
        workers=workers,
        progress=progress,
    )
    rows = [
        damper_._asdict() | dict(outcome["figures"]) | {"error": outcome["error"] or ""}
        for damper_, outcome in zip(dampers, study.outcomes, strict=True)
    ]
    return pandas.DataFrame(rows)


def check_workers(workers: object) -> None:
    """Refuse a number of processes that is none."""
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise InputError(f"workers = {quote(workers)}; give an integer from 1 on")


LAW = "polynomial-spring"
"""The law that predicts the damper's swings best among those without a fitted height map; its
coefficients are the spring's Taylor series about rest."""
STARTS = 8
SHOWN_EVERY = 5
"""Every fifth sample of the motion is kept for its picture."""


@keep_measure_name("reduced_models.designs.figures:damper_figures#8b0ef787")
def measure_damper_figures(run: Trajectory) -> Mapping[str, Any]:
    """Heights and gaps [m], frequency [Hz] and law of a damper that fell, rested, was lifted and released."""
    bed, motion = measure_rest_and_gaps(run), fit_motion_figures(run.piston("release").with_time_from_zero())
    return {"rest_height": bed.pop("rest_height"), **motion, **bed}


def measure_rest_and_gaps(run: Trajectory) -> dict[str, float]:
    """Heights [m] of `measure_damper_figures` that no law is fitted for."""
    settings = run.settings()
    return {
        "rest_height": run.stage("drop").height,
        "rest_gap": _least_gap(run),
        "fall_gap": settings["closest_distance"] / run.scene.grains.species[0].diameter,
        "ledger": settings["ledger_residual"],
    }


def fit_motion_figures(motion: PistonRecord) -> dict[str, float]:
    """Frequency [Hz], damping ratio, misfit and the law's lam [1/s], k1 [1/s^2], k2, k3 after the release."""
    from reduced_models.fitting.fit import fit

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(motion, law=LAW, test_fraction=0.0, starts=STARTS)
    resting = model.at_rest
    return {
        "frequency": float("nan") if resting is None else 1.0 / resting.period,
        "damping_ratio": float("nan") if resting is None else resting.damping_ratio,
        **{name: model.parameters[name] for name in ("lam", "k1", "k2", "k3")},
        "misfit": model.quality.relative,
    }


def _least_gap(run: Trajectory) -> float:
    from scipy.spatial.distance import pdist

    positions = run.dataset["position"].values[_resting_frame(run)]
    radii = 0.5 * run.scene.grains.diameters()
    rows, columns = np.triu_indices(len(radii), 1)
    return float((pdist(positions) / (radii[rows] + radii[columns])).min())


def _resting_frame(run: Trajectory) -> int:
    return int(np.abs(run.dataset["frame_time"].values - run.stage("drop").end).argmin())


@keep_measure_name("reduced_models.designs.study:check_with_slopes#1")
def measure_design_check(run: Trajectory) -> Mapping[str, Any]:
    """`measure_rest_and_gaps`, the motion after the release as columns, and slopes at the equilibrium."""
    columns = run.piston("release").with_time_from_zero().columns
    positions, by_part = run.dataset["position"].values[_resting_frame(run)], {}
    try:
        rest = equilibrium_from(run.scene, positions, run.stage("drop").height)
        positions, by_part = rest.positions, slopes_by_part(rest)
    except InputError:  # some beds rearrange under the smallest push
        pass
    return {
        **measure_rest_and_gaps(run),
        "motion": {name: values.tolist() for name, values in columns.items()},
        "positions": positions.tolist(),
        "slopes": by_part,
    }


def figures_of_design_check(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of a run's check, and its motion, times [s] and heights [m], for a picture."""
    motion = PistonRecord.from_columns(columns["motion"])
    return {
        **{name: value for name, value in columns.items() if name != "motion"},
        **fit_motion_figures(motion),
        "times": motion.time[::SHOWN_EVERY].tolist(),
        "heights": motion.height[::SHOWN_EVERY].tolist(),
    }
