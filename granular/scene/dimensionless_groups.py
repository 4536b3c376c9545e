"""Dimensionless groups of a damper, and the same damper in another size.

Lengths times s, times s^(1/2), masses s^2 and currents s change neither the acceleration of gravity nor the
magnetic constant, so every equation of a bed stays. By dimensional analysis, rest/W, f sqrt(W/g) and zeta of
a packing depend on N, kappa = mu0 m^2/(pi M g W^4), N m_g/M, gamma sqrt(W/g)/M (zeta is proportional to it if
small), on D/W by the laws of walls, and for discs and rows of magnets on h/D and the rows' pitch over W.
"""

from __future__ import annotations

import math
from typing import Any

from granular.parts.moment import LATTICE_SUM
from granular.scene.scene import Scene
from granular.schema.field_kinds import PointListKind, QuantityKind, QuantityListKind, TemperatureKind
from granular.schema.natural_units import Scales
from granular.schema.sections import find_field
from granular.schema.units import unit_size
from granular.shared.errors import InputError

LATTICE_PRESSURE = 0.1875 * LATTICE_SUM * 0.75**0.75
"""Pressure of a triangular lattice of dipoles over (F*/D) (rho D^2)^2.5, 1.6675: 3/2 of its energy."""

_EXPONENTS = (1.0, 2.0, 0.5, 1.0)  # of length, mass, time and current


def dimensionless_groups(scene: Scene) -> dict[str, float]:
    """Return what rest/W, f sqrt(W/g) and zeta of a packing depend on; nothing without weight and mass."""
    piston, gravity, effects = scene.piston, getattr(scene.effects, "gravity", None), scene.effects
    if piston is None or not piston.mass or gravity is None or not gravity.acceleration:
        return {}
    scales, width, mass = Scales.from_grains(scene.grains), scene.cell.width, piston.mass
    weight, drag_unit = mass * gravity.acceleration, mass * math.sqrt(gravity.acceleration / width)
    groups: dict[str, float] = {
        "N": scene.grains.count,
        "kappa": scales.force * (scales.length / width) ** 4 / weight,
        "N m/M": float(scene.grains.masses().sum()) / mass,
    }
    if effects.drag is not None:
        groups["gamma sqrt(W/g)/M"] = effects.drag.coefficient / drag_unit
    if piston.drag:
        groups["piston's gamma sqrt(W/g)/M"] = piston.drag / drag_unit
    groups["D/W"] = scales.length / width
    walls = () if effects.walls is None else effects.walls.present_walls
    pitches = {wall.pitch for _, wall in walls if wall.pitch is not None}
    if pitches or scene.grains.magnets == "cylinders":
        thickness = float(scene.grains.species_values("thickness")[0])
        groups["h/D"] = thickness / scales.length
    if len(pitches) == 1:
        groups["pitch/W"] = pitches.pop() / width
    return groups


def groups_line(scene: Scene) -> str:
    """Return the groups of a scene in one line; empty without any."""
    return ", ".join(f"{name} {value:.4g}" for name, value in dimensionless_groups(scene).items())


def lattice_rest(count: int, width: float, kappa: float) -> float:
    """Rest N W (1.6675 kappa)^0.4 of a triangular lattice of dipoles without weight [m]; width [m]."""
    return count * width * (LATTICE_PRESSURE * kappa) ** 0.4


def rescale(scene: Scene, width: float) -> Scene:
    """Return the damper of another width [m] with every dimensionless group equal.

    Remanence, pressures and gravity stay; the drags that follow from a liquid's name become numbers.
    """
    parts: list[Any] = [*scene.effects.in_loop_order, *scene.protocol]
    if any(part.user_code_digests for part in parts):
        raise InputError(f"scene {scene.name!r} has parts of one's own, in units unknown; leave them out")
    factor, drag, changes = width / scene.cell.width, scene.effects.drag, dict[str, Any]()
    if drag is not None and drag.viscosity is not None:
        changes["effects.drag"] = {"coefficient": drag.coefficient}
    if scene.piston is not None and scene.piston.has_parts:
        changes["piston.drag"] = scene.piston.drag
    scene = scene.replace(**changes)
    return Scene.from_plain(_scaled(scene, "", scene.to_plain(), factor))


def _scaled(scene: Scene, key: str, value: Any, factor: float) -> Any:
    """Plain data of a key in another size."""
    if isinstance(value, dict):
        return {name: _scaled(scene, f"{key}.{name}" if key else name, value[name], factor) for name in value}
    _, kind = (key and find_field(scene, key)) or (None, None)
    if isinstance(kind, TemperatureKind):
        return value
    if isinstance(kind, QuantityListKind):
        kind = kind.element
    if isinstance(kind, QuantityKind | PointListKind) and not isinstance(value, str):
        powers = unit_size(kind.unit)[1]
        size = factor ** sum(a * b for a, b in zip(_EXPONENTS, powers, strict=True))
        return _times(value, size)
    if isinstance(value, list):
        return [_scaled(scene, f"{key}.{index}", item, factor) for index, item in enumerate(value)]
    return value


def _times(value: Any, size: float) -> Any:
    return [_times(item, size) for item in value] if isinstance(value, list | tuple) else value * size
