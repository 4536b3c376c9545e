"""Options of a run, as requested: the methods, time steps and ends that a scene can have."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator

import numpy as np

from granular.engine.step_size import MOST_STEPS, StepRequest
from granular.methods.method import COMPENSATED, Method
from granular.methods.registry import resolve_method
from granular.protocol import Hold, Lift, Stage
from granular.protocol.stage import TimedStage
from granular.scene.dry_friction import dissipative_parts, dry_friction_parts
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.message_text import quote

LATEST = 1e30
"""Latest end of a run [s]: as far as quantities go, and far from overflow in any natural unit."""

_AUTOMATIC = re.compile(r"auto(?:([*/])(\d+\.?\d*|\.\d+))?")


def parse_time_step(dt: float | str, scene: Scene | None = None) -> StepRequest:
    """Parse a time step: seconds, or a multiple of the automatic one; dt [s]."""
    step = (
        StepRequest()
        if scene is None
        else StepRequest(grains=scene.grains.count, dry=_allows_longer_steps(scene))
    )
    if isinstance(dt, str):
        match = _AUTOMATIC.fullmatch(dt)
        if match is None:
            raise InputError(f"dt = {quote(dt)}; give seconds, 'auto', or a multiple such as 'auto/2'")
        factor = float(match[2] or 1.0)
        factor = 1.0 / factor if match[1] == "/" and factor else factor
        if not 0.0 < factor <= step.greatest_factor:
            raise InputError(
                f"dt = {quote(dt)}; the automatic step may be multiplied by more than 0 and at "
                f"most {step.greatest_factor:g}"
            )
        return dataclasses.replace(step, factor=factor)
    if isinstance(dt, bool) or not isinstance(dt, int | float) or not 0.0 < dt < math.inf:
        raise InputError(f"dt = {quote(dt)}; give a time step above 0 s, or 'auto'")
    return dataclasses.replace(step, seconds=float(dt))


def _allows_longer_steps(scene: Scene) -> bool:
    """Return True where dry friction between grains and plates allows longer steps."""
    friction, contact = scene.effects.friction, scene.effects.contact
    return friction is not None and friction.scheme == "velocity" and contact is None


def halve_time_step(dt: float | str) -> float | str:
    """Halve a time step; dt [s]."""
    return _multiply_time_step(dt, 0.5)


def double_time_step(dt: float | str) -> float | str:
    """Double a time step; dt [s]."""
    return _multiply_time_step(dt, 2.0)


def _multiply_time_step(dt: float | str, by: float) -> float | str:
    step = parse_time_step(dt)
    if step.seconds is not None:
        return by * step.seconds
    factor = by * step.factor
    if factor >= 1.0:
        return f"auto*{_format_decimal(factor)}"
    return f"auto/{_format_decimal(1.0 / factor)}"


def _format_decimal(value: float) -> str:
    return np.format_float_positional(value, trim="-")


def can_run_with_step(scene: Scene, dt: float | str, method: str | Method) -> bool:
    """Test whether a scene can be run with a time step and a method; dt [s]."""
    try:
        step = parse_time_step(dt, scene)
        check_method_fits_scene(resolve_method(method), step, scene)
        check_time_step_fits_scene(step, scene)
    except InputError:
        return False
    return True


def check_method_fits_scene(method: Method, step: StepRequest, scene: Scene) -> None:
    """Refuse a method that a scene, or a time step, cannot be run with."""
    if method.tableau is not None:
        parts = dissipative_parts(scene) or ("host",) * (scene.effects.host is not None)
        if parts:
            raise InputError(
                f"method = {method.name!r} takes forces alone, and cannot run a scene with {parts[0]!r}; "
                "take 'stormer-verlet', or leave that part out"
            )
    dry = dry_friction_parts(scene)
    if dry and method.compensated:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with {dry[0]}, whose velocities are no "
            f"plain sums; take {method.name.removesuffix(COMPENSATED)!r}"
        )
    if dry and not method.allows_dry_friction:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with {dry[0]}, which cannot go backward "
            "in time, nor be part of its steps; take 'stormer-verlet'"
        )
    drifting = [effect.key for effect in scene.effects.in_loop_order if effect.drifts]
    if drifting and (not method.allows_far_field_impulses or method.compensated):
        raise InputError(
            f"method = {method.name!r} cannot run a scene with {drifting[0]!r}, which acts within "
            "the drift; take 'stormer-verlet'"
        )
    if not method.variable:
        return
    if not step.automatic:
        raise InputError(
            f"dt = {step.seconds!r}: {method.name!r} chooses its own steps; give 'auto', or a "
            "multiple such as 'auto/2'"
        )
    if scene.cell.periods is not None:
        raise InputError(
            f"method = {method.name!r} cannot run a periodic cell: its steps follow grains, not "
            "their images; take 'stormer-verlet'"
        )
    walls = scene.effects.walls
    if walls is not None and walls.has_slab:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with a slab, past whose ends grains may "
            "come behind it; take 'stormer-verlet'"
        )


def check_time_step_fits_scene(step: StepRequest, scene: Scene, t_end: float | None = None) -> None:
    """Refuse a given time step that is longer than what it is to resolve, or far too short; t_end [s]."""
    dt = step.seconds
    if dt is None:
        return
    record = scene.output.scalars
    if record > MOST_STEPS * dt:
        raise InputError(
            f"dt = {dt:g} s makes {record / dt:.3g} steps from record to record, {MOST_STEPS:g} is "
            "the limit; lengthen dt or shorten output.scalars"
        )
    if dt > record * (1.0 + 1e-9):
        raise InputError(
            f"dt = {dt:g} s is longer than from record to record, output.scalars = {record:g} s; "
            "shorten dt or lengthen output.scalars"
        )
    if t_end is not None and dt > t_end:
        raise InputError(f"dt = {dt:g} s is longer than the run, t_end = {t_end:g} s; shorten dt")
    for stage, duration in _known_stage_durations(scene, t_end):
        if 0.0 < duration < dt * (1.0 - 1e-9):
            raise InputError(f"dt = {dt:g} s is longer than stage {stage.name!r}, {duration:g} s; shorten dt")


def _known_stage_durations(scene: Scene, t_end: float | None) -> Iterator[tuple[Stage, float]]:
    """Stages whose duration is known before the run [s]; one that ends the run has its end."""
    height = 0.0 if scene.piston is None else scene.piston.height
    for stage in scene.protocol:
        height += stage.initial_jump(height)
        duration = stage.total_duration(height)
        last = stage is scene.protocol[-1] and isinstance(stage, TimedStage)
        if duration is not None and math.isfinite(duration) and not (last and t_end is not None):
            yield stage, duration
        final = stage.prescribed_final_height()
        if final is not None and not stage.ends_at_force:
            height = final
        elif not isinstance(stage, Hold | Lift):
            height = math.nan  # known when the stage has ended


def check_end_time(scene: Scene, t_end: float | None) -> None:
    """Refuse an end of the run that is not a time, and a protocol without an end; t_end [s]."""
    number = isinstance(t_end, int | float) and not isinstance(t_end, bool)
    if t_end is not None and not (number and 0.0 < t_end <= LATEST):
        raise InputError(f"t_end = {quote(t_end)}; give a time above 0 s and up to {LATEST:g} s")
    if not scene.protocol:
        raise InputError("the scene has no protocol; give it at least one stage, such as a hold")
    height = 1.0 if scene.piston is None else scene.piston.height
    for index, stage in enumerate(scene.protocol):
        if stage.total_duration(height) is None and (t_end is None or index < len(scene.protocol) - 1):
            raise InputError(
                f"stage {stage.name!r} has no end; give it a duration, until = 'rest', or t_end "
                "where it is the last"
            )
