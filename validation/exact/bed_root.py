"""The piston's root of three magnets at rest, and the errors that methods make in it."""

from __future__ import annotations

import functools
from typing import Any

from granular import Equilibrium, load_scene
from granular.linear import Root, piston_roots, root_of_steps
from granular.linear.equilibrium import equilibrium_from, settled_state
from granular.methods import method_named

NAME = "bed-root"

# A piston as light as three magnets has a root near those of the grains: a step that resolves all is then not
# so short for it that rounding hides its error.
CHANGES: dict[str, Any] = {
    "grains.count": 3,
    "cell.width": "3 D",
    "piston.mass": 0.002,
    "piston.height": "6 D",
    "arrangement.height": "5 D",
    "effects.drag.coefficient": 0.01,
}


@functools.cache
def _settled_roots() -> dict[bool, tuple[Equilibrium, Root]]:
    """Equilibrium and exact root without drag, which Runge-Kutta methods refuse, and with it."""
    scene, positions, height = settled_state(load_scene("damper").replace(**CHANGES))
    result = {}
    for drags in (False, True):
        variant = scene if drags else scene.replace(**{"effects.drag": None})
        rest = equilibrium_from(variant, positions, height)
        result[drags] = rest, piston_roots(rest)[0]
    return result


def settled_root(method: str) -> tuple[Equilibrium, Root]:
    """Equilibrium that a method can run from, and its exact root."""
    return _settled_roots()[method_named(method).tableau is None]


def root_error(method: str, dt: float, exact: complex | None = None) -> float:
    """Error of a method's root over the exact one, or over another that is given [1/s]; dt [s]."""
    rest, root = settled_root(method)
    exact = root.s if exact is None else exact
    return abs(root_of_steps(rest, root, dt, method) - exact) / abs(exact)
