"""Plan of a run: method, time step, pair sum, threads and engine, chosen before the first step.

During the run the number of threads is chosen from measured step times; the results are bit for bit the same
for any number. If other programs use the processors, several threads that wait for each other can be hundreds
of times slower than a single one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import math
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, partial
from typing import Any

import numba

from granular.engine.step_size import MAXIMUM_STEPS, StepRequest, auto_step_text
from granular.methods.method import COMPENSATED, Method
from granular.methods.tables import resolve_method
from granular.pairs.direct_sum import MIN_GRAINS_FOR_PARTS, PARTS
from granular.pairs.pair_sum_settings import PairSumSettings
from granular.protocol import Hold, Lift, Stage
from granular.protocol.stage import TimedStage
from granular.run.engines import ENGINES, NUMBA
from granular.run.work_precision import (
    FLOORS,
    MOTION,
    SceneWorkPrecision,
    list_applicable_measured_scenes,
    load_work_precision_scenes,
    most_similar_measured_scene,
    settings_within_tolerance,
)
from granular.scene.scene import Scene, dissipative_parts, dry_friction_parts
from granular.scene.scene_in_natural_units import SceneInNaturalUnits, scene_in_natural_units
from granular.shared.errors import InputError, quote, unknown_word_message

SHORTEST, LONGEST = 1.0, 60.0
"""Initial and maximum delay [s] before the slower number of threads is tried again. Each trial doubles the
delay."""


class ThreadCountTuner:
    """Choice between one thread and the maximum number, from step times measured during the run."""

    def __init__(self, maximum: int) -> None:
        self.maximum = self.count = maximum
        self.trying = maximum > 1
        self._took: dict[int, float] = {}
        self._until, self._wait = 0.0, SHORTEST

    def note_step_time_and_choose_count(self, steps: int, seconds: float) -> None:
        """Record the duration [s] of steps with the present number of threads, and choose the next number."""
        if self.maximum == 1 or steps == 0:
            return
        self._took[self.count] = seconds / steps
        now = time.perf_counter()
        other = 1 if self.count == self.maximum else self.maximum
        if self.trying and other in self._took:
            self.trying, self._until = False, now + self._wait
            self._wait = min(2.0 * self._wait, LONGEST)
            self.count = min(self._took, key=lambda count: self._took[count])
        elif now >= self._until:
            self.trying, self.count = True, other
        set_thread_count(self.count)


def choose_thread_count(scene: Scene, requested: int | None) -> int:
    """Return the requested number of threads, or else the largest number that can be faster than one."""
    available = int(numba.config.NUMBA_NUM_THREADS)
    if requested is None:
        parted = scene.pair_method != "verlet-list" and scene.grains.count > MIN_GRAINS_FOR_PARTS
        return min(available, PARTS) if parted and _threads_start_quickly(scene) else 1
    if isinstance(requested, bool) or not isinstance(requested, int) or not 1 <= requested <= available:
        raise InputError(f"threads = {quote(requested)} must be an integer from 1 to {available}")
    return requested


def _threads_start_quickly(scene: Scene) -> bool:
    """Return True for a direct sum without ``far_every``, or if Numba can use OpenMP or TBB."""
    if scene.pair_method == "direct" and scene.pairs.far_every is None:
        return True
    # No times are compared here. Numba's workqueue threads take about 50 us to start, several times a step of
    # near pairs and mesh; OpenMP and TBB threads take one or two.
    if numba.config.THREADING_LAYER == "workqueue":
        return False
    for pool in ("omppool", "tbbpool"):
        with contextlib.suppress(ImportError):
            importlib.import_module(f"numba.np.ufunc.{pool}")
            return True
    return False


def set_thread_count(count: int) -> None:
    """Set the number of threads that compiled kernels use."""
    try:
        numba.set_num_threads(max(1, min(count, numba.config.NUMBA_NUM_THREADS)))
    except ValueError as error:
        layer = os.environ.get("NUMBA_THREADING_LAYER")
        reason = " ".join(str(error).split())
        raise InputError(f"NUMBA_THREADING_LAYER = {layer!r} cannot be used ({reason}); unset it") from None


METHOD = "stormer-verlet"

LATEST = 1e30
"""Latest end of a run [s]; up to this time, times in natural units do not overflow."""

SCATTER = "scatter"
"""Value of the argument ``accuracy`` that requests errors below the spread over random packings."""

MESH_ERROR = 5e-4
"""Relative error of the forces computed by the mesh in a bed at rest; tests check this value."""

_ACCURACY = re.compile(
    r"\s*(?P<value>\+?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<percent>%?)\s+(?P<quantity>\D.*?)\s*"
)
_AUTOMATIC = re.compile(r"auto(?:([*/])(\d+\.?\d*|\.\d+))?")


@dataclasses.dataclass(frozen=True)
class Plan:
    """Plan of a run, made by `plan`.

    Attributes
    ----------
    scene : Scene
        Scene to run; a requested accuracy may have changed its method of summing pairs.
    dt : float or str
        Time step [s], or a multiple of the automatic one, such as "auto*2".
    method : Method
        Integration method.
    step : StepRequest
        The time step as used by the run.
    threads : int
        Number of threads, from 1.
    tries_threads : bool
        True if the run may use a single thread when that is faster.
    t_end : float or None
        End of the run [s]; None: the end of its protocol.
    engine : str
        Name of the engine that advances the bed.
    refusals : mapping of str to str
        The arguments "method", "dt" or "t_end" that do not suit the scene, each with the reason in one
        line.
    words : str
        Method, step and sum over pairs chosen for a requested accuracy, with reasons; empty without a
        requested accuracy.
    """

    scene: Scene
    dt: float | str
    method: Method
    step: StepRequest
    threads: int
    tries_threads: bool
    t_end: float | None
    engine: str
    refusals: Mapping[str, str]
    words: str = ""

    @property
    def pair_sum(self) -> str:
        """Name of the method of summing pairs."""
        return self.scene.pair_method

    @cached_property
    def system(self) -> SceneInNaturalUnits:
        """Scene in natural units, made on first access."""
        return scene_in_natural_units(self.scene, threads=self.threads, method=self.method)

    @property
    def suits(self) -> bool:
        """True if the scene can be run with the method and the step, whether or not ``t_end`` is valid."""
        return self.refusals.keys().isdisjoint(("method", "dt"))

    def take_system(self) -> SceneInNaturalUnits:
        """Return the scene in natural units as a new object, which a run may modify.

        Returns
        -------
        SceneInNaturalUnits
            Scene in natural units, not shared with another run.
        """
        system = self.system
        del self.__dict__["system"]
        return system

    def check_arguments(self) -> None:
        """Raise `InputError` if the plan has refusals."""
        for words in self.refusals.values():
            raise InputError(words)

    def to_plain(self) -> dict[str, Any]:
        """Return the plan as plain data, with all its refusals.

        Returns
        -------
        dict
            Method, dt, pairs, threads and engine by name, and the refusals.
        """
        refusals = list(self.refusals.values())
        try:
            self.system  # noqa: B018 (a mesh may not fit into memory)
        except InputError as error:
            refusals.append(str(error))
        return {
            "method": self.method.name,
            "dt": self.dt,
            "pairs": self.pair_sum,
            "threads": self.threads,
            "engine": self.engine,
            "refusals": refusals,
        }

    def __str__(self) -> str:
        step, seconds = self.step, self.step.seconds
        automatic = f"{self.dt}, {step.step_times_frequency:.3g} divided by the highest angular frequency"
        lines = [
            f"method: {self.method.name}, of order {self.method.order}",
            f"step: {automatic if seconds is None else f'{seconds:g} s'}",
            f"sum over pairs: {self.pair_sum}",
            f"threads: {self.threads}",
            *(f"refused: {words}" for words in self.to_plain()["refusals"]),
        ]
        return "\n".join(lines + [f"chosen for {self.words}"] * bool(self.words))


def plan(
    scene: Scene,
    dt: float | str = "auto",
    method: str | Method | Mapping[str, Any] = METHOD,
    *,
    t_end: float | None = None,
    accuracy: str | None = None,
    threads: int | None = None,
    engine: str = NUMBA,
    runs: int = 1,
) -> Plan:
    """Decide how a scene is run, without running it.

    Parameters
    ----------
    scene : Scene
        Scene to run.
    dt : float or str
        Time step [s], "auto", or a multiple of it such as "auto/2".
    method : str, Method or mapping
        Integration method, as `granular.simulate` takes it.
    t_end : float, optional
        End of the run [s].
    accuracy : str, optional
        A maximum error and a quantity, such as "1e-3 rest height", or the word "scatter". For an error and a
        quantity, the plan takes method, step and sum over pairs from measured tables: first the package's
        table, then the user's table, which `validation.recommend_settings` fills. "scatter" chooses the
        coarsest step and the fastest sum over pairs whose errors are below the spread over random packings,
        or the automatic step for a scene that is not in a table.
    threads : int, optional
        Number of threads; default: as many as can shorten the run.
    engine : str
        Name of the engine: "numba", or an installed one (entry points "granular.engines").
    runs : int
        Number of runs that share compiled code, which affects the choice of the fastest sum over pairs.

    Returns
    -------
    Plan
        Scene, method, step, sum over pairs, threads, engine and refusals.

    Raises
    ------
    InputError
        If an argument is invalid, such as an unknown method, or an accuracy cannot be guaranteed. Arguments
        that do not suit the scene raise no error here: the plan lists them in ``refusals``, and `simulate`
        raises the error.

    Examples
    --------
    >>> from granular import load_scene, plan
    >>> chosen = plan(load_scene("damper"), accuracy="1 % rest height")
    >>> chosen.method.name, chosen.dt, chosen.pair_sum, chosen.refusals
    ('stormer-verlet', 'auto*8', 'direct', {})
    """
    if accuracy is not None:
        if dt != "auto" or (method != METHOD and accuracy != SCATTER):
            raise InputError(
                "accuracy already determines dt and method; give either accuracy, or dt and method"
            )
        given = partial(plan, t_end=t_end, threads=threads, engine=engine)
        if accuracy == SCATTER:
            return _plan_with_errors_below_packing_spread(scene, resolve_method(method), runs, given)
        return _plan_for_accuracy(scene, accuracy, t_end, given)
    number = isinstance(t_end, int | float) and not isinstance(t_end, bool)
    if t_end is not None and not (number and 0.0 < t_end <= LATEST):
        raise InputError(
            f"t_end = {quote(t_end)} is outside the limits; give a time above 0 s and up to {LATEST:g} s"
        )
    resolved, step = resolve_method(method), parse_time_step(dt, scene)
    ENGINES.find(engine)
    count = choose_thread_count(scene, threads)
    refusals: dict[str, str] = {}
    for argument, words in _refused_arguments_and_reasons(scene, resolved, step, t_end):
        refusals.setdefault(argument, words)
    return Plan(scene, dt, resolved, step, count, threads is None, t_end, engine, refusals)


def can_run(scene: Scene, dt: float | str, method: str | Method) -> bool:
    """Return True if a scene can be run with a time step [s] and a method, whatever the end of the run."""
    try:
        return plan(scene, dt, method).suits
    except InputError:  # an invalid multiple of the automatic step
        return False


# Steps ------------------------------------------------------------------------------------------


def parse_time_step(dt: float | str, scene: Scene | None = None) -> StepRequest:
    """Parse a time step given in s or as a multiple of a scene's automatic step."""
    step = StepRequest()
    if scene is not None:
        friction, contact = scene.effects.friction, scene.effects.contact
        dry = friction is not None and friction.scheme == "velocity" and contact is None
        step = StepRequest(grains=scene.grains.count, dry=dry)
    if isinstance(dt, str):
        match = _AUTOMATIC.fullmatch(dt)
        if match is None:
            raise InputError(
                f"dt = {quote(dt)} is not a time step; give seconds, 'auto', or a multiple such as 'auto/2'"
            )
        factor = float(match[2] or 1.0)
        factor = 1.0 / factor if match[1] == "/" and factor else factor
        if not 0.0 < factor <= step.maximum_multiple_of_automatic_step:
            raise InputError(
                f"dt = {quote(dt)} has a factor outside the limits; give a factor above 0 and up to "
                f"{step.maximum_multiple_of_automatic_step:g}"
            )
        return dataclasses.replace(step, factor=factor)
    if isinstance(dt, bool) or not isinstance(dt, int | float) or not 0.0 < dt < math.inf:
        raise InputError(f"dt = {quote(dt)} is not a time step; give one above 0 s, or 'auto'")
    return dataclasses.replace(step, seconds=float(dt))


def scaled_time_step_setting(dt: float | str, by: float) -> float | str:
    """Multiply a time step, given in s or as a multiple of the automatic step, by a factor."""
    step = parse_time_step(dt)
    return auto_step_text(by * step.factor) if step.seconds is None else by * step.seconds


def _automatic_step_multiple_text(scene: Scene, fraction: float) -> str:
    """Return a step as a multiple of the automatic step; ``fraction`` is step times highest frequency."""
    step = parse_time_step("auto", scene)
    factor = min(fraction / step.step_times_frequency, step.maximum_multiple_of_automatic_step)
    # Rounded down to hundredths, so that the error stays below the bound.
    if factor < 1.0:
        return auto_step_text(100.0 / math.ceil(100.0 / factor - 1e-6))
    return auto_step_text(math.floor(100.0 * factor + 1e-6) / 100.0)


# Accuracies -------------------------------------------------------------------------------------


def parse_tolerance_and_quantity(text: str) -> tuple[float, str]:
    """Parse an accuracy such as "1e-4 rest height" or "1 % piston force"."""
    match = _ACCURACY.fullmatch(text) if isinstance(text, str) else None
    value = float(match["value"]) if match else math.nan
    if match is None or not 0.0 < value < math.inf:
        raise InputError(
            f"accuracy = {quote(text)} cannot be read; give an error above 0 and a quantity, such as "
            "'1 % rest height'"
        )
    return value * (0.01 if match["percent"] else 1.0), match["quantity"]


def _plan_for_accuracy(scene: Scene, text: str, t_end: float | None, given: Callable[..., Plan]) -> Plan:
    """Plan a run with the fastest method and step in the first table that guarantees the accuracy."""
    tolerance, quantity = parse_tolerance_and_quantity(text)
    prefix = f"accuracy = {quote(text)}: "
    causes = []
    for costs in list_applicable_measured_scenes(scene, quantity, t_end):
        try:
            steps = settings_within_tolerance(costs, quantity, tolerance, scene.grains.count)
        except InputError as error:
            causes.append(f"{prefix}{error}")
            continue
        scene_with_sum, sum_name = _scene_and_name_of_accurate_pair_sum(scene, quantity, tolerance, prefix)
        for _, fraction, method, bound in steps:
            dt = _automatic_step_multiple_text(scene, fraction)
            chosen = given(scene_with_sum, dt, method)
            if chosen.suits:
                floor = costs.scatter_for_grain_count(quantity, scene.grains.count)
                spread = f", spread over packings {floor:.1g}" if floor else ""
                words = (
                    f"{quantity} to {tolerance:g}: {method}, dt {dt}, {sum_name}; error of the step at most "
                    f"{bound:.1g}{spread} ({costs.name}, {costs.starts} starts, {costs.date})"
                )
                return dataclasses.replace(chosen, words=words)
        minimum = min(entry.bounds[quantity] for entry in costs.entries)
        causes.append(
            f"{prefix}the smallest error in the table of measured errors is {costs.margin * minimum:.2g}, "
            "including its safety factor; request that error, or measure this scene with: "
            "granular-damper validate cheapest"
        )
    names = sorted({name for entry in load_work_precision_scenes() for name in entry.floors})
    if not causes and quantity not in names:
        raise InputError(unknown_word_message(quantity, names, "quantity"))
    not_measured = (
        f"{prefix}the tables of measured errors have no scene like {scene.name!r} with this quantity; "
        "measure the scene with: granular-damper validate cheapest"
    )
    raise InputError(next(iter(causes), not_measured))


def _scene_and_name_of_accurate_pair_sum(
    scene: Scene, quantity: str, tolerance: float, prefix: str
) -> tuple[Scene, str]:
    """Return the scene with a sum over pairs that meets the tolerance, and the name of that sum."""
    method = scene.pair_method
    if method in ("cut-off", "verlet-list"):
        raise InputError(
            f"{prefix}pairs.method = {method!r} omits pairs, an error that no time step reduces; use 'auto'"
        )
    if method == "mesh" and quantity != "energy" and tolerance < 2.0 * MESH_ERROR:
        return scene.replace(**{"pairs.method": "direct"}), "direct sum"
    return scene, "mesh sum" if method == "mesh" else "direct sum"


def _plan_with_errors_below_packing_spread(
    scene: Scene, method: Method, runs: int, given: Callable[..., Plan]
) -> Plan:
    """Plan a run with the coarsest step and fastest pair sum whose errors are below the packings' spread."""
    costs = most_similar_measured_scene(scene, MOTION[0])
    if costs is None:
        return given(scene, "auto", method)
    fraction = costs.longest_step_times_frequency_within_scatter(method.name)
    longer = fraction > parse_time_step("auto", scene).step_times_frequency
    dt = _automatic_step_multiple_text(scene, fraction) if longer else "auto"
    if _mesh_is_fastest(scene, method, runs, costs):
        chosen = given(scene.replace(**{"pairs.method": "mesh"}), dt, method)
        with contextlib.suppress(InputError):  # a cell whose mesh does not fit into memory
            chosen.system  # noqa: B018 (made on access)
            return chosen
    return given(scene, dt, method)


MESH_PAYS_FROM = 320
"""Minimum number of grains for which two identifications of a damper are faster with the mesh than with the
direct sum.

An identification makes 1.24e6 steps on two processors. With 368 grains, a step takes 22.5 us with the mesh
and 37.8 us with the direct sum; with 500 grains, 33.1 us and 67.1 us. Compilation before the first
identification takes 18.0 s for the mesh and 7.7 s for the direct sum. With 368 grains and the mesh, the first
identification is therefore 0.8 s slower, and each later one 9.5 s faster. From 377 grains, the first one is
faster too."""


def _mesh_is_fastest(scene: Scene, method: Method, runs: int, costs: SceneWorkPrecision) -> bool:
    """Return True if several runs are faster by the mesh, with an error below the spread over packings."""
    count = scene.grains.count
    # The spread varies as the inverse square root of the number of grains, also beyond the table.
    spread = min(costs.floors[name] for name in MOTION) * math.sqrt(costs.grains / count)
    return (
        runs > 1
        and count >= MESH_PAYS_FROM
        and FLOORS * spread >= MESH_ERROR
        and scene.pairs == PairSumSettings()
        and scene.grains.magnets == "dipoles"
        and method.allows_far_field_impulses
        and not method.compensated
    )


# Refusals ---------------------------------------------------------------------------------------


def _refused_arguments_and_reasons(
    scene: Scene, method: Method, step: StepRequest, t_end: float | None
) -> Iterator[tuple[str, str]]:
    """Yield the arguments that do not suit a scene, each with the reason."""
    for words in _reasons_against_method(scene, method):
        yield "method", f"method = {method.name!r} {words}"
    if method.variable and not step.is_automatic:
        yield (
            "dt",
            f"dt = {step.seconds!r} cannot be set for {method.name!r}, which adapts its steps; give 'auto' "
            "or 'auto/2'",
        )
    for words in _reasons_against_end(scene, t_end):
        yield "t_end", words
    if step.seconds is not None:
        for words in _reasons_against_step(scene, step.seconds, t_end):
            yield "dt", f"dt = {step.seconds:g} s {words}"


def _reasons_against_method(scene: Scene, method: Method) -> Iterator[str]:
    dry, effects, walls = dry_friction_parts(scene), scene.effects.in_loop_order, scene.effects.walls
    flows = dissipative_parts(scene) or ("host",) * (scene.effects.host is not None)
    verlet, run = "use 'stormer-verlet'", "cannot run a scene with"
    if method.tableau is not None and flows:
        yield f"supports only conservative forces, and {run} {flows[0]!r}; {verlet}, or remove that part"
    if dry and method.compensated:
        plain = method.name.removesuffix(COMPENSATED)
        yield f"{run} {dry[0]}, which sets velocities to zero instead of adding to them; use {plain!r}"
    if dry and not method.allows_dry_friction:
        yield f"{run} {dry[0]}, which is undefined for negative or variable steps; {verlet}"
    drifting = [effect.key for effect in effects if effect.drifts]
    if drifting and (not method.allows_far_field_impulses or method.compensated):
        yield f"{run} {drifting[0]!r}, which changes velocities while a step moves the grains; {verlet}"
    if method.variable and scene.cell.periods is not None:
        yield f"cannot run a periodic cell, because its steps ignore the periodic images; {verlet}"
    if method.variable and walls and any(wall.law == "slab" for _, wall in walls.sides_with_walls):
        yield f"{run} a wall of the law 'slab', because grains may pass the slab's ends; {verlet}"


def _reasons_against_step(scene: Scene, dt: float, t_end: float | None) -> Iterator[str]:
    """Yield the reasons why a given time step [s] is too long or far too short."""
    record = scene.output.scalars
    if record > MAXIMUM_STEPS * dt:
        yield (
            f"makes {record / dt:.3g} steps between records, but the limit is {MAXIMUM_STEPS:g}; lengthen dt "
            "or shorten output.scalars"
        )
    if dt > record * (1.0 + 1e-9):
        yield (
            f"is longer than the time between records, output.scalars = {record:g} s; shorten dt or lengthen "
            "output.scalars"
        )
    if t_end is not None and dt > t_end:
        yield f"is longer than the run, t_end = {t_end:g} s; shorten dt"
    for stage, duration in _stages_with_known_duration(scene, t_end):
        if 0.0 < duration < dt * (1.0 - 1e-9):
            yield f"is longer than stage {stage.name!r}, {duration:g} s; shorten dt"


def _stages_with_known_duration(scene: Scene, t_end: float | None) -> Iterator[tuple[Stage, float]]:
    """Yield each stage of known duration and its duration [s], except a last stage that ends at ``t_end``."""
    height = 0.0 if scene.piston is None else scene.piston.height
    for stage in scene.protocol:
        height += stage.initial_jump(height)
        duration = stage.maximum_duration(height)
        last = stage is scene.protocol[-1] and isinstance(stage, TimedStage)
        if duration is not None and math.isfinite(duration) and not (last and t_end is not None):
            yield stage, duration
        final = stage.prescribed_final_height()
        if final is not None and not stage.ends_at_force:
            height = final
        elif not isinstance(stage, Hold | Lift):
            height = math.nan  # unknown until the stage has ended


def _reasons_against_end(scene: Scene, t_end: float | None) -> Iterator[str]:
    """Yield the reasons why a run would not end."""
    if not scene.protocol:
        yield "the scene has no protocol; add one or more stages to it, such as a hold"
    height = 1.0 if scene.piston is None else scene.piston.height
    for index, stage in enumerate(scene.protocol):
        if stage.maximum_duration(height) is None and (t_end is None or index < len(scene.protocol) - 1):
            yield (
                f"stage {stage.name!r} has no end; give the stage a duration or until = 'rest'; the last "
                "stage may also be ended by t_end"
            )
