"""Forces of a bed at rest by approximate pair sums, compared with the direct sum.

A bed with drag only at packing 0.241 comes to rest by the direct sum; from there each method brings it to
rest again, so that the results differ only by the sum.
"""

from __future__ import annotations

from typing import Any

from granular import simulate
from granular.scene.scene import Scene
from validation.accuracy_cost import disturbed_lattice_scene

FORCES = ("piston_force", "left_force", "right_force", "bottom_force")
METHODS = ("mesh", "cut-off")

FIRST, AGAIN = 20.0, 8.0
"""Times to come to rest from a lattice, and again [s]: several decay times of the slowest mode."""

STEP = "auto*4"
"""Time step: the equilibrium does not depend on it."""


def _at_rest(scene: Scene, method: str, seconds: float) -> tuple[Scene, dict[str, float]]:
    """Return the scene after a time [s], with forces and maximum speed."""
    changes: dict[str, Any] = {
        "pairs.method": method,
        "protocol": [{"name": "settle", "kind": "hold", "duration": seconds}],
    }
    run = simulate(scene.replace(**changes), dt=STEP, progress=False)
    values = {name: float(run.dataset[name].values[-1]) for name in (*FORCES, "greatest_speed")}
    places = run.dataset["position"].values[-1].tolist()
    return scene.replace(**{"arrangement": {"positions": places, "speed": 0.0}}), values


def forces_at_rest(count: int) -> list[dict[str, Any]]:
    """Return piston and wall forces [N] at rest by each method, and deviations from the direct sum.

    The mesh settles the bed first, which saves the direct sum most of its time.
    """
    scene, _ = _at_rest(disturbed_lattice_scene(count), "mesh", FIRST)
    scene, exact = _at_rest(scene, "direct", AGAIN)
    rows: list[dict[str, Any]] = [{"method": "direct", "grains": count, **exact}]
    for method in METHODS:
        _, result = _at_rest(scene, method, AGAIN)
        off = {f"{name} off": result[name] / exact[name] - 1.0 for name in FORCES}
        rows.append({"method": method, "grains": count, **result, **off})
    return rows
