"""Which methods and time steps a scene can be run with."""

from __future__ import annotations

from granular.engine.step_size import Step
from granular.methods import COMPENSATED, Method, method_named
from granular.run.time_step import checked_step
from granular.scene.dryness import dry_parts
from granular.scene.scene import Scene
from granular.shared.errors import InputError


def is_allowed(scene: Scene, dt: float | str, method: str) -> bool:
    """Whether a scene can be run with a time step and a method."""
    try:
        check_method(method_named(method), checked_step(dt, scene), scene)
    except InputError:
        return False
    return True


def check_method(method: Method, step: Step, scene: Scene) -> None:
    """Refuse a method that a scene, or a time step, cannot be run with.

    Raises
    ------
    InputError
        Which names what the method cannot take, and another one.
    """
    dry = dry_parts(scene)
    if dry and method.compensated:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with {dry[0]}, whose velocities are no "
            f"plain sums; take {method.name.removesuffix(COMPENSATED)!r}"
        )
    if dry and not method.takes_dry_friction:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with {dry[0]}, which cannot go backward "
            "in time, nor be part of its steps; take 'stormer-verlet'"
        )
    if not method.variable:
        return
    if not step.automatic:
        raise InputError(
            f"dt = {step.seconds!r}: {method.name!r} chooses its own steps; give 'auto', or a "
            "multiple such as 'auto/2'"
        )
    walls = scene.effects.walls
    if walls is not None and walls.has_slab:
        raise InputError(
            f"method = {method.name!r} cannot run a scene with a slab, past whose ends grains may "
            "come behind it; take 'stormer-verlet'"
        )
