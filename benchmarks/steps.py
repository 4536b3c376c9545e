"""Whole steps of the engine: by pair sum, by number of threads, and by effect."""

from __future__ import annotations

import math
import warnings
from functools import partial
from typing import Any

import numba
import numpy as np

from benchmarks.engine import PAIR_METHODS, bed_of
from benchmarks.timing import minimum_seconds
from granular import evaluate, simulate
from granular.pairs.direct_sum import MIN_GRAINS_FOR_PARTS
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import EnergyError
from validation.overview import EngineSteps

STEPS = 32
"""Number of steps timed together, so that they share work done once in several steps."""

DRIFT_STEPS = 2000
"""Number of steps over which the energy drift is measured."""

_PLATE = {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm"}

EFFECTS: dict[str, dict[str, Any]] = {
    "dipole, walls": {},
    "discs, walls": {"grains.magnets": "cylinders"},
    "infinite walls": {f"effects.walls.{side}": "infinite" for side in ("left", "right", "top")},
    "slabs below and above": {"effects.walls.bottom": "slab", "effects.walls.top": "slab"},
    "gravity": {"effects.gravity": {}},
    "drag": {"effects.drag": {}},
    "dry friction": {"effects.friction": {}},
    "contact": {"effects.contact.modulus": 1e7},
    "shaking": {"effects.shaking": {"amplitude": "0.1 mm", "frequency": 20.0}},
    "eddy currents": {"effects.eddy": _PLATE | {"mutual": False}},
    "eddy currents, mutual": {"effects.eddy": _PLATE | {"mutual": True}},
    "eddy currents, mutual, thick plate": {"effects.eddy": _PLATE | {"mutual": True, "plate": "thick"}},
    "two species": {
        "grains.species": [
            {"name": "big", "diameter": "6 mm", "share": 0.5},
            {"name": "small", "diameter": "4 mm", "share": 0.5},
        ]
    },
}
"""Changes to a bed with dipoles and walls only."""

MIN_GRAINS_FOR_MESH = 2000

_BARE: dict[str, Any] = {"effects.gravity": None, "effects.drag": None}


def method_steps(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return the time of a step [s] by each pair sum, on one core, with moving grains."""
    engines = {name: EngineSteps(bed_of(count, {"pairs.method": name})) for name in PAIR_METHODS}
    calls = {name: partial(engine.make_steps, STEPS) for name, engine in engines.items()}
    result = minimum_seconds(calls, rounds=rounds, seconds=0.0)
    return [
        {"method": name, "grains": count, "seconds": time / STEPS, "times direct": result["direct"] / time}
        for name, time in result.items()
    ]


def thread_steps(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return the time of a step [s] with one and two threads, by each pair sum."""
    if numba.config.NUMBA_NUM_THREADS < 2 or count < MIN_GRAINS_FOR_PARTS:
        return []
    rows = []
    for name in PAIR_METHODS:
        scene = bed_of(count, {"pairs.method": name})
        engines = {threads: EngineSteps(scene, threads) for threads in (1, 2)}
        calls = {str(k): partial(engine.make_steps, STEPS) for k, engine in engines.items()}
        result = minimum_seconds(calls, rounds=rounds, seconds=0.0)
        alike = bool((engines[1].run.state.x == engines[2].run.state.x).all())
        rows += [
            {
                "method": name,
                "grains": count,
                "threads": int(k),
                "seconds": time / STEPS,
                "times one": result["1"] / time,
                "same bits": alike,
            }
            for k, time in result.items()
        ]
    return rows


def effect_steps(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return the time of a step [s] with each effect, and the difference to dipoles and walls only.

    Large beds are summed by the mesh, which does not support slabs.
    """
    bare, effects = _BARE, EFFECTS
    if count > MIN_GRAINS_FOR_MESH:
        bare = _BARE | {"pairs.method": "mesh"}
        effects = {name: changes for name, changes in EFFECTS.items() if "slabs" not in name}
    engines = {name: EngineSteps(bed_of(count, bare | changes)) for name, changes in effects.items()}
    steps = max(STEPS, math.ceil(2e7 / count**2))
    calls = {name: partial(engine.make_steps, steps) for name, engine in engines.items()}
    result = minimum_seconds(calls, rounds=rounds, seconds=0.0)
    base = next(iter(result.values()))
    return [
        {
            "effect": name,
            "grains": count,
            "seconds": time / steps,
            "added": (time - base) / steps,
            "fraction": time / base - 1.0,
        }
        for name, time in result.items()
    ]


def method_errors(count: int) -> list[dict[str, Any]]:
    """Return the errors of forces and energy by each pair sum."""
    bare = _BARE | {"arrangement.speed": "0.1 D/s"}
    scenes = {name: bed_of(count, bare | {"pairs.method": name}) for name in PAIR_METHODS}
    positions, _ = scenes["direct"].initial_positions_and_velocities()
    exact, scale = evaluate(scenes["direct"], positions), _magnitude(scenes["direct"], positions)
    rows = []
    for name, scene in scenes.items():
        result = evaluate(scene, positions)
        error = np.linalg.norm(result.force - exact.force, axis=1).max() / scale
        rows.append(
            {"method": name, "grains": count, "force error": float(error), "energy drift": _drift(scene)}
        )
    return rows


def _magnitude(scene: Scene, positions: np.ndarray) -> float:
    """Return the rms over the grains of the sum of |f| of their pairs [N]."""
    scales = Scales.from_grains(scene.grains)
    index, sums = positions / scales.length, np.zeros(len(positions))
    for i in range(len(index)):
        r2 = ((index[i] - index) ** 2).sum(axis=1)
        r2[i] = np.inf
        sums[i] = (0.75 / r2**2).sum()
    return float(np.sqrt((sums**2).mean()) * scales.force)


def _drift(scene: Scene) -> float:
    """Return the residual of the ledger of a run without dissipation, over the energy turned over.

    If the ledger stops the run, it is the residual at that time.
    """
    dt = 0.02 * Scales.from_grains(scene.grains).time
    scene = scene.replace(
        **{
            "protocol": [{"kind": "hold", "name": "hold", "duration": DRIFT_STEPS * dt}],
            "output": {"scalars": 20.0 * dt, "frames": DRIFT_STEPS * dt},
        }
    )
    with warnings.catch_warnings():
        # The energy error of a poor sum is measured here, so its warning is suppressed.
        warnings.simplefilter("ignore")
        try:
            run = simulate(scene, dt=dt, threads=1, progress=False)
        except EnergyError as stop:
            return math.nan if stop.value is None else stop.value
    return float(run.settings()["ledger_residual"])
