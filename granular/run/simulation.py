"""`simulate`: from a scene to a trajectory."""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.compiled.compile_timer import CompileTimer, measure_compile_time
from granular.engine.run_errors import raise_where_not_finite
from granular.engine.step_size import Step
from granular.methods.method import Method
from granular.methods.registry import method_setting, resolve_method
from granular.run.accuracy import choose_settings
from granular.run.checkpoint import read_checkpoint, read_files
from granular.run.directory import SETTINGS, is_run_directory
from granular.run.progress import ProgressBar
from granular.run.recorder import Recorder
from granular.run.run import Run
from granular.run.snapshot import restore_snapshot, take_snapshot
from granular.run.store import Store
from granular.run.threads import Threads, choose_threads, set_threads
from granular.run.time_steps import check_end, check_method, check_step, validated_step
from granular.run.trajectory import Trajectory, load_trajectory, make_trajectory
from granular.scene.dry_friction import degraded_residual_limit
from granular.scene.scene import Scene
from granular.scene.system import SceneInNaturalUnits, explain_compile_errors, scene_in_natural_units
from granular.shared.errors import InputError, RunError, StoreError
from granular.shared.stops import Stop, deferred_stop
from granular.shared.version import versions

if TYPE_CHECKING:
    import xarray

CADENCE = 0.01
"""Relative change of the records' distance, by a given step, that is reported to the user."""

COMMIT_SECONDS = 5.0
"""From checkpoint to checkpoint, in seconds of the wall clock."""


def simulate(
    scene: Scene,
    dt: float | str = "auto",
    t_end: float | None = None,
    method: str | Method | Mapping[str, Any] = "stormer-verlet",
    out: str | Path | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: bool = True,
    accuracy: str | None = None,
) -> Trajectory:
    """Run a scene.

    Parameters
    ----------
    scene : Scene
        Scene to run.
    dt : float or str
        Time step [s]. "auto" follows the stiffest mode that the bed can meet (see
        `granular.engine.step_size`); "auto/2" or "auto*2" is half or twice as long, to see what
        the step does to a result.
    t_end : float, optional
        Stop at this time [s], also within a stage; a last stage that is timed is lengthened up to
        it. Without: at the end of the protocol.
    method : str or Method
        Integration method, the name of one of `granular.methods.METHODS`; "+compensated" behind it
        turns positions and velocities into compensated sums. Or a `granular.Method` of one's own,
        also as its plain data: its table goes into the run's settings.
    out : str or Path, optional
        Directory to write to while running; it must be empty or not exist yet.
    resume : bool
        Go on with the run in ``out`` (or start it, where there is none yet). The bits are those of
        a run that was never interrupted.
    threads : int, optional
        The result has the same bits for any number. Without: as many as pay off.
    progress : bool
        Show a progress bar on standard error.
    accuracy : str, optional
        Instead of ``dt`` and ``method``: an error and the quantity it is of, such as "1e-3 rest
        height"; step, method and sum over pairs are then chosen from the stored table of prices
        (see `granular.run.accuracy`), and stored in the run's ``settings()["accuracy"]``.

    Returns
    -------
    Trajectory
        Finished run with its data in SI units.

    Raises
    ------
    InputError
        If an argument or the scene cannot be run, ``out`` is in use, or an accuracy cannot be
        promised.
    RunError
        If the run cannot be trusted any more; its ``trajectory`` attribute holds what was
        computed before.
    Interrupted
        On Ctrl-C (on the command line also on SIGTERM); its ``trajectory`` attribute holds what
        was computed.

    Examples
    --------
    >>> from granular import damper, simulate
    >>> run = simulate(damper(count=92), t_end=0.1, progress=False)
    >>> run.dataset["piston_height"].attrs["units"], len(run.dataset["frame_time"])
    ('m', 2)
    """
    promised: dict[str, Any] = {}
    if accuracy is not None:
        if dt != "auto" or method != "stormer-verlet":
            raise InputError("accuracy chooses dt and method; give either it or them")
        scene, dt, method, words = choose_settings(scene, accuracy)
        promised = {"accuracy": words}
    plan = resolve_method(method)
    step = validated_step(dt, scene)
    check_method(plan, step, scene)
    check_end(scene, t_end)
    check_step(step, scene, t_end)
    _warn_of_cadence(step, scene)
    count = choose_threads(scene, threads)
    system = scene_in_natural_units(scene, threads=count, method=plan)
    set_threads(count)
    settings = _settings(scene, dt, plan, system) | promised
    if resume and out is None:
        raise InputError("resume = True needs out, the directory of the run to go on with")
    run = Run(scene, system, plan, step, t_end)
    run.threads = Threads(count if threads is None else 1)
    with deferred_stop() as stop, measure_compile_time() as compiling:
        store = None if out is None else _open_store(Path(out), run, settings, resume)
        try:
            with explain_compile_errors(scene):
                return _Job(run, store, settings, compiling).carry_out(progress, stop)
        finally:
            if store is not None:
                store.release()


class _Job:
    """A run with its output: what `simulate` does after the arguments are checked."""

    def __init__(
        self, run: Run, store: Store | None, settings: dict[str, Any], compiling: CompileTimer
    ) -> None:
        self.run, self.store, self.settings, self.compiling = run, store, settings, compiling
        self.started = self.last_commit = time.perf_counter()
        self.kept = self._snapshot()

    def carry_out(self, progress: bool, stop: Stop) -> Trajectory:
        run = self.run
        self._commit(complete=False)
        failure = partial(run.misplaced_grain_error, run.shorter_step_remedy)
        with ProgressBar(progress) as bar:
            try:
                while not run.at_end and not stop.asked:
                    with raise_where_not_finite(failure):
                        run.advance()
                    bar.show(run)
                    if time.perf_counter() - self.last_commit > COMMIT_SECONDS:
                        self.kept = self._snapshot()
                        self._commit(complete=False)
                self.kept = self._snapshot()
                complete = run.at_end
                with raise_where_not_finite(failure):
                    until = run.run_tail() if complete else run.time
            except RunError as error:
                error.trajectory = self._result(complete=False, until=run.time)
                raise
            except KeyboardInterrupt:  # from a compilation
                stop.trajectory = self._result(complete=False, until=run.time)
                raise
        stop.trajectory = trajectory = self._result(complete, until)
        if complete:
            _warn_of_doubts(trajectory)
        return trajectory

    def _snapshot(self) -> dict[str, Any]:
        """State to resume from, with how many records and frames lie before it."""
        rows, frames = self.run.recorder.counts()
        written = (0, 0) if self.store is None else (self.store.rows, self.store.frames)
        return take_snapshot(self.run) | {"rows": written[0] + rows, "frames": written[1] + frames}

    def _outcome(self, complete: bool, until: float) -> dict[str, Any]:
        compiled, passed = self.compiling.seconds, time.perf_counter() - self.started
        figures = self.run.figures() | {"seconds": passed - compiled, "compile_seconds": compiled}
        return {"figures": figures, "complete": complete, "stages": self.run.results(until)}

    def _commit(self, complete: bool, until: float | None = None) -> None:
        """Write what was recorded, with the last snapshot to resume from."""
        if self.store is None:
            return
        outcome = self._outcome(complete, self.run.time if until is None else until)
        try:
            self.store.write(self.run.recorder)
            self.store.commit(self.kept | {"outcome": np.array(json.dumps(outcome))})
        except OSError as error:
            raise StoreError(
                f"{self.store.path} cannot be written: {error.strerror or error}; what was "
                "committed stands, resume it when there is room"
            ) from error
        self.last_commit = time.perf_counter()

    def _result(self, complete: bool, until: float) -> Trajectory:
        if self.store is not None:
            self._commit(complete, until)
            return load_trajectory(self.store.path)
        run = self.run
        data = _dataset(run.scene, run.system, run.recorder)
        return make_trajectory(run.scene, data, self.settings, self._outcome(complete, until), None)


def _dataset(scene: Scene, system: SceneInNaturalUnits, recorder: Recorder) -> xarray.Dataset:
    """Return the recorded data in SI, from memory."""
    import xarray

    return xarray.Dataset(
        {
            variable.name: (variable.dims, values, variable.attributes())
            for variable, values in recorder.in_si(scene, system.scales)
        }
    )


def _warn_of_cadence(step: Step, scene: Scene) -> None:
    if step.seconds is None:
        return
    wanted = scene.output.scalars
    made = round(wanted / step.seconds) * step.seconds
    if abs(made - wanted) > CADENCE * wanted:
        warnings.warn(
            f"records come every {made:.4g} s, not {wanted:.4g} s, which is no multiple of dt = "
            f"{step.seconds:g} s",
            stacklevel=3,
        )


def _settings(scene: Scene, dt: float | str, method: Method, system: SceneInNaturalUnits) -> dict[str, Any]:
    far = system.constants.acting.far
    asked = None if far is None else far.every or scene.pairs.far_every
    every = {} if asked is None else {"far_every": asked}
    return {
        "scene_digest": scene.digest(),
        "dt": dt,
        "method": method_setting(method),
        "pairs": scene.pair_method,
        **every,
        "versions": versions(),
        **({"own": own} if (own := custom_code_digests(scene)) else {}),
    }


def custom_code_digests(scene: Scene) -> list[str]:
    """Digests of a user's own functions in a scene, and of what is derived from formulas."""
    own = [part.sources for part in scene.effects.in_loop_order] + [stage.sources for stage in scene.protocol]
    return sorted(digest for sources in own for digest in sources)


def _open_store(path: Path, run: Run, settings: dict[str, Any], resume: bool) -> Store:
    if is_run_directory(path) and not resume:
        raise StoreError(f"{path} holds a run; resume it, or give a new directory")
    if not is_run_directory(path):
        first = take_snapshot(run) | {"rows": 0, "frames": 0}
        outcome = {"figures": run.figures(), "complete": False, "stages": []}
        first["outcome"] = np.array(json.dumps(outcome))
        return Store.create(path, run.scene, run.system, settings, first)
    former = json.loads(read_files(path, read_checkpoint(path)[1])[SETTINGS])
    for name in ("scene_digest", "dt", "method"):
        if former[name] != settings[name]:
            what = "scene" if name == "scene_digest" else name
            raise StoreError(
                f"the run in {path} has another {what}: {former[name]}, not {settings[name]}; "
                "resume with the same, or give a new directory"
            )
    if former.get("own", []) != settings.get("own", []):
        raise StoreError(
            f"the run in {path} was made with other functions of an own effect, which have changed "
            "since; resume with the same, or give a new directory"
        )
    if former.get("versions") != settings["versions"]:
        warnings.warn(
            f"the run in {path} was made with other versions ({former.get('versions')}); what "
            "follows need not have the bits that it would have had",
            stacklevel=3,
        )
    store = Store(path, run.scene, run.system)
    store.hold()
    try:
        restore_snapshot(run, store.resume())
    except BaseException:
        store.release()
        raise
    return store


def _warn_of_doubts(trajectory: Trajectory) -> None:
    """Warn where a run is less accurate than a user may take it to be."""
    settings = trajectory.settings()
    residual = settings["ledger_residual"]
    if residual > degraded_residual_limit(trajectory.scene):
        remedy = "a shorter dt is more accurate"
        if trajectory.scene.pair_method == "verlet-list":
            remedy += ", and so is pairs.method = 'direct', without a list that misses pairs"
        warnings.warn(
            f"the energy ledger is off by {residual:.2g} of the energy turned over; {remedy}", stacklevel=3
        )
    closest = settings.get("closest_distance", math.inf)
    least = min(specy.diameter for specy in trajectory.scene.grains.species)
    if closest < least and trajectory.scene.effects.contact is None:
        warnings.warn(
            f"two grains came as close as {closest:.3g} m, less than a diameter ({least:.3g} m), "
            "and the scene has no contact between grains",
            stacklevel=3,
        )
