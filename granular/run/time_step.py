"""Time steps as they are asked for: seconds, or multiples of the automatic step."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np

from granular.engine.step_size import Step
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.messages import quoted

_AUTOMATIC = re.compile(r"auto(?:([*/])(\d+\.?\d*|\.\d+))?")


def checked_step(dt: float | str, scene: Scene | None = None) -> Step:
    """A time step in seconds, or a multiple of the automatic one, of a scene.

    Raises
    ------
    InputError
        If it is neither.
    """
    step = Step() if scene is None else Step(grains=scene.grains.count, dry=_glides(scene))
    if isinstance(dt, str):
        match = _AUTOMATIC.fullmatch(dt)
        if match is None:
            raise InputError(
                f"dt = {quoted(dt)}; give seconds, 'auto', or a multiple such as 'auto/2'"
            )
        factor = float(match[2] or 1.0)
        factor = 1.0 / factor if match[1] == "/" and factor else factor
        if not 0.0 < factor <= step.longest:
            raise InputError(
                f"dt = {quoted(dt)}; the automatic step may be multiplied by more than 0 and at "
                f"most {step.longest:g}"
            )
        return dataclasses.replace(step, factor=factor)
    if isinstance(dt, bool) or not isinstance(dt, int | float) or not 0.0 < dt < math.inf:
        raise InputError(f"dt = {quoted(dt)}; give a time step above 0 s, or 'auto'")
    return dataclasses.replace(step, seconds=float(dt))


def _glides(scene: Scene) -> bool:
    """Whether dry friction between grains and plates allows longer steps."""
    friction, contact = scene.effects.friction, scene.effects.contact
    return friction is not None and friction.scheme == "velocity" and contact is None


def halved(dt: float | str) -> float | str:
    """Half a time step, given in seconds or as a multiple of the automatic one."""
    return _scaled(dt, 0.5)


def doubled(dt: float | str) -> float | str:
    """Twice a time step, given in the same ways."""
    return _scaled(dt, 2.0)


def _scaled(dt: float | str, by: float) -> float | str:
    step = checked_step(dt)
    if step.seconds is not None:
        return by * step.seconds
    factor = by * step.factor
    if factor >= 1.0:
        return f"auto*{_positional(factor)}"
    return f"auto/{_positional(1.0 / factor)}"


def _positional(value: float) -> str:
    return np.format_float_positional(value, trim="-")
