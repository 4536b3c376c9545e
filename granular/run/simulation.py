"""`simulate`: run a scene, and return its trajectory."""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from granular.compiled.numba_insides import CompileTimer, measure_compile_time
from granular.engine.run_errors import report_arithmetic_errors_as
from granular.methods.method import Method
from granular.methods.tables import method_as_run_setting
from granular.protocol.stages import check_spline_stages
from granular.run.dataset import check_variable_names
from granular.run.engines import NUMBA
from granular.run.plan import METHOD, Plan, plan, set_thread_count
from granular.run.protocol_runner import ProtocolRunner
from granular.run.run_directory import (
    SETTINGS,
    is_run_directory,
    read_checkpoint_and_manifest,
    read_verified_files,
)
from granular.run.run_directory_writer import RunDirectoryWriter, restore_snapshot, take_snapshot
from granular.run.run_progress_bar import RunProgressBar
from granular.run.summary import custom_code_digests
from granular.run.trajectory import Trajectory, load_trajectory, make_trajectory
from granular.scene.scene import Scene, degraded_energy_residual_limit
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, RunError, StoreError
from granular.shared.stop_signals import StopRequest, defer_stop_signals
from granular.shared.version import toolkit_and_library_versions

SPACING_TOLERANCE = 0.01
"""A run warns if rounding to whole steps changes the interval between records by more than this fraction."""

COMMIT_SECONDS = 5.0
"""Wall-clock time between checkpoints [s]."""

_COMPILE_ONLY_TIME = 1e-6
"""End [s] of the short runs that are made only to compile kernels."""


def simulate(
    scene: Scene | Plan,
    dt: float | str = "auto",
    t_end: float | None = None,
    method: str | Method | Mapping[str, Any] = METHOD,
    out: str | Path | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: bool = True,
    accuracy: str | None = None,
    engine: str = NUMBA,
) -> Trajectory:
    """Run a scene through its protocol.

    Parameters
    ----------
    scene : Scene or Plan
        Scene to run, with one or more stages; or a plan from `granular.plan`, which already includes
        ``dt``, ``t_end``, ``method``, ``threads``, ``accuracy`` and ``engine``.
    dt : float or str
        Time step [s]. "auto" resolves the highest frequency that the bed can reach (see
        `granular.engine.step_size`); "auto/2" or "auto*2" is half or twice as long, to test the
        influence of the step.
    t_end : float, optional
        End of the run [s], which may be within a stage; if the last stage has a duration, it is extended to
        ``t_end``. Default: the end of the protocol.
    method : str, Method or mapping
        Name of an integration method in `granular.methods.METHODS`, or a custom `granular.Method`, also as
        plain data. The coefficients of a custom method are stored in the run's settings. The suffix
        "+compensated" after a name computes positions and velocities with compensated sums (Kahan).
    out : str or Path, optional
        Directory to write to during the run; it must be empty or new.
    resume : bool
        Continue the run in ``out``, or start it if there is none. The result is bit for bit the same as
        without interruption.
    threads : int, optional
        Number of threads, from 1 to the number of processors; the result is bit for bit the same for any
        number. Default: as many as shorten the run.
    progress : bool
        Show a progress bar on standard error.
    accuracy : str, optional
        Error and quantity, such as "1e-3 rest height", instead of ``dt`` and ``method``. Step, method and
        sum over pairs are then chosen from measured tables (see `granular.plan`) and stored in the run's
        ``settings()["accuracy"]``.
    engine : str
        Name of the engine that advances the bed: "numba", or an installed one (entry points
        "granular.engines").

    Returns
    -------
    Trajectory
        Finished run with its data in SI units.

    Raises
    ------
    InputError
        If an argument or the scene is invalid, ``out`` is in use, cannot be written or holds another
        run, or an accuracy cannot be guaranteed.
    RunError
        If the run can no longer be trusted, for example because the energy balance is wrong; the error's
        ``trajectory`` attribute holds the results so far.
    Interrupted
        On Ctrl-C (on the command line also on SIGTERM); the error's ``trajectory`` attribute holds the
        results so far.

    Warns
    -----
    UserWarning
        If the interval between records is rounded from ``output.scalars`` to whole steps, the energy balance
        has a large residual, grains overlapped without a contact law, or the run in ``out`` was made with
        other versions.

    Examples
    --------
    >>> from granular import damper, simulate
    >>> run = simulate(damper(count=92), t_end=0.1, progress=False)
    >>> run.dataset["piston_height"].attrs["units"], len(run.dataset["frame_time"])
    ('m', 2)
    """
    if not isinstance(scene, Plan):
        chosen = plan(scene, dt, method, t_end=t_end, accuracy=accuracy, threads=threads, engine=engine)
    elif (dt, t_end, method, threads, accuracy, engine) == ("auto", None, METHOD, None, None, NUMBA):
        chosen = scene
    else:
        raise InputError(
            "the plan already includes dt, t_end, method, threads, accuracy and engine; give them to plan"
        )
    scene = chosen.scene
    check_variable_names(scene)
    chosen.check_arguments()
    if scene.piston is not None:
        check_spline_stages(scene.protocol, scene.piston.height, Scales.from_grains(scene.grains))
    _warn_of_changed_record_spacing(chosen)
    settings = _run_settings(chosen)
    if resume and out is None:
        raise InputError(
            "resume = True also needs the argument out; give the directory of the run to continue"
        )
    set_thread_count(chosen.threads)
    run = ProtocolRunner(chosen)
    with defer_stop_signals() as stop:
        store = None if out is None else _create_or_resume_directory(Path(out), run, settings, resume)
        try:
            # The timing starts here, since restoring a run may compile before.
            with measure_compile_time() as compiling:
                return _SimulationJob(run, store, settings, compiling).run_to_end(progress, stop)
        finally:
            if store is not None:
                store.unlock()


class _SimulationJob:
    """Work of `simulate` after its arguments are checked: the run and its output."""

    def __init__(
        self,
        run: ProtocolRunner,
        store: RunDirectoryWriter | None,
        settings: dict[str, Any],
        compiling: CompileTimer,
    ) -> None:
        self.run, self.store, self.settings, self.compiling = run, store, settings, compiling
        self.started = self.last_commit = time.perf_counter()
        self.snapshot = self._snapshot_with_counts()

    def run_to_end(self, progress: bool, stop: StopRequest) -> Trajectory:
        run = self.run
        self._write_and_commit(complete=False)
        failure = partial(run.misplaced_grain_error, run.remedy_for_long_steps)
        with RunProgressBar(progress) as bar:
            try:
                while not run.is_at_end and not stop.is_requested:
                    with report_arithmetic_errors_as(failure):
                        run.advance()
                    bar.show(run)
                    if time.perf_counter() - self.last_commit > COMMIT_SECONDS:
                        self.snapshot = self._snapshot_with_counts()
                        self._write_and_commit(complete=False)
                self.snapshot = self._snapshot_with_counts()
                complete = run.is_at_end
                with report_arithmetic_errors_as(failure):
                    until = run.finish_last_partial_tick_and_return_end() if complete else run.present_time
            except RunError as error:
                error.trajectory = self._save_and_load_trajectory(complete=False, until=run.present_time)
                raise
            except KeyboardInterrupt:  # from a compilation
                stop.trajectory = self._save_and_load_trajectory(complete=False, until=run.present_time)
                raise
        stop.trajectory = trajectory = self._save_and_load_trajectory(complete, until)
        if complete:
            _warn_of_inaccurate_run(trajectory)
        return trajectory

    def _snapshot_with_counts(self) -> dict[str, Any]:
        """Take a snapshot from which the run can resume, with the numbers of records and frames before it."""
        rows, frames = self.run.recorder.record_and_frame_counts()
        written = {"time": 0, "frame": 0} if self.store is None else self.store.lengths
        counts = {"rows": written["time"] + rows, "frames": written["frame"] + frames}
        return take_snapshot(self.run) | counts

    def _outcome_fields(self, complete: bool, until: float) -> dict[str, Any]:
        compiled, passed = self.compiling.seconds, time.perf_counter() - self.started
        figures = self.run.summary_values() | {"seconds": passed - compiled, "compile_seconds": compiled}
        stages, departures = self.run.stage_results(until), self.run.progress.departures
        return {"figures": figures, "complete": complete, "stages": stages, "departures": departures}

    def _write_and_commit(self, complete: bool, until: float | None = None) -> None:
        """Write the recorded data, and the last snapshot as the checkpoint."""
        if self.store is None:
            return
        outcome = self._outcome_fields(complete, self.run.present_time if until is None else until)
        try:
            self.store.append_records(self.run.recorder)
            self.store.replace_checkpoint(self.snapshot | {"outcome": np.array(json.dumps(outcome))})
        except OSError as error:
            raise StoreError(
                f"{self.store.path} cannot be written: {error.strerror or error}; the data up to the last "
                "checkpoint are kept: resume the run when there is space"
            ) from error
        self.last_commit = time.perf_counter()

    def _save_and_load_trajectory(self, complete: bool, until: float) -> Trajectory:
        if self.store is not None:
            self._write_and_commit(complete, until)
            return load_trajectory(self.store.path)
        import xarray

        run = self.run
        recorded = run.recorder.variables_in_si(run.scene)
        data = {item.name: (item.dims, values, item.attributes()) for item, values in recorded}
        outcome = self._outcome_fields(complete, until)
        return make_trajectory(run.scene, xarray.Dataset(data), self.settings, outcome, None)


def _warn_of_changed_record_spacing(plan: Plan) -> None:
    step, requested = plan.step, plan.scene.output.scalars
    if step.seconds is None:
        return
    spacing = round(requested / step.seconds) * step.seconds
    if abs(spacing - requested) > SPACING_TOLERANCE * requested:
        warnings.warn(
            f"records come every {spacing:.4g} s, not {requested:.4g} s: output.scalars is not a multiple of "
            f"dt = {step.seconds:g} s",
            stacklevel=3,
        )


def _run_settings(plan: Plan) -> dict[str, Any]:
    scene, far = plan.scene, plan.system.constants.acting.far
    interval = None if far is None else far.every or scene.pairs.far_every
    far_field = {} if interval is None else {"far_every": interval}
    return {
        "scene_digest": scene.digest(),
        "dt": plan.dt,
        "method": method_as_run_setting(plan.method),
        "pairs": plan.pair_sum,
        "engine": plan.engine,
        **far_field,
        "versions": toolkit_and_library_versions(),
        **({"own": own} if (own := custom_code_digests(scene)) else {}),
        **({"accuracy": plan.words} if plan.words else {}),
    }


def _create_or_resume_directory(
    path: Path, run: ProtocolRunner, settings: dict[str, Any], resume: bool
) -> RunDirectoryWriter:
    if is_run_directory(path) and not resume:
        raise StoreError(f"{path} already holds a run; resume it, or give a new directory")
    if not is_run_directory(path):
        first = take_snapshot(run) | {"rows": 0, "frames": 0}
        outcome = {"figures": run.summary_values(), "complete": False, "stages": []}
        first["outcome"] = np.array(json.dumps(outcome))
        return RunDirectoryWriter.create(path, run.scene, settings, first)
    former = {"engine": NUMBA} | json.loads(
        read_verified_files(path, read_checkpoint_and_manifest(path)[1])[SETTINGS]
    )
    for name in ("scene_digest", "dt", "method", "engine"):
        if former[name] != settings[name]:
            setting = "scene" if name == "scene_digest" else name
            raise StoreError(
                f"the run in {path} has another {setting}: {former[name]}, not {settings[name]}; "
                f"resume with the same {setting}, or give a new directory"
            )
    if former.get("own", []) != settings.get("own", []):
        raise StoreError(
            f"functions of a custom effect have changed since the run in {path} was made; "
            "resume with the same functions, or give a new directory"
        )
    if former.get("versions") != settings["versions"]:
        warnings.warn(
            f"the run in {path} was made with other versions ({former.get('versions')}); "
            "its continuation may differ by rounding",
            stacklevel=3,
        )
    store = RunDirectoryWriter(path, run.scene)
    store.lock()
    try:
        restore_snapshot(run, store.read_checkpoint_and_arrays())
    except BaseException:
        store.unlock()
        raise
    return store


def _warn_of_inaccurate_run(trajectory: Trajectory) -> None:
    """Warn if a run is less accurate than a user may expect."""
    settings = trajectory.settings()
    residual = settings["ledger_residual"]
    if residual > degraded_energy_residual_limit(trajectory.scene):
        remedy = "shorten dt"
        if trajectory.scene.pair_method == "verlet-list":
            remedy += ", or use pairs.method = 'direct', which misses no pairs"
        warnings.warn(
            f"the energy balance is off by {residual:.2g} of the energy turned over; {remedy}", stacklevel=3
        )
    closest = settings.get("closest_distance", math.inf)
    smallest = min(specy.diameter for specy in trajectory.scene.grains.species)
    if closest < smallest and trajectory.scene.effects.contact is None:
        warnings.warn(
            f"two grains came as close as {closest:.3g} m, less than a diameter ({smallest:.3g} m), "
            "but the scene has no contact law",
            stacklevel=3,
        )


def compile_and_cache_kernels(scenes: Sequence[Scene]) -> dict[str, float]:
    """Compile and cache the kernels for runs and evaluations of scenes; return the time [s] by scene."""
    from granular.protocol.piston_motion import PistonMotion, driven_height_and_velocity
    from granular.run.evaluation import evaluate

    seconds = {}
    for scene in scenes:
        started = time.perf_counter()
        simulate(scene, t_end=_COMPILE_ONLY_TIME, progress=False)
        evaluate(scene, *scene.initial_positions_and_velocities())
        driven_height_and_velocity(PistonMotion(), 0.0)
        seconds[scene.name] = time.perf_counter() - started
    return seconds
