"""Filling the cache of compiled kernels, so that later starts need not compile."""

from __future__ import annotations

import time
from collections.abc import Sequence

from granular.scene.loading import load_scene, scene_names
from granular.scene.scene import Scene

_INSTANT = 1e-6
"""Of a run [s]: the loop is compiled before its first step."""


def warm_up(scenes: Sequence[str | Scene] = ()) -> dict[str, float]:
    """Compile what runs and evaluations of scenes need, and keep it on disk.

    Parameters
    ----------
    scenes : sequence of str or Scene
        All packaged scenes if none is given. What is compiled depends on which effects act, on how
        pairs are summed and on the method, not on numbers: a bed of another size, or another mass
        of the piston, needs nothing more.

    Returns
    -------
    dict of str to float
        Wall time of each [s], by its name; below a second where all was there.

    Raises
    ------
    InputError
        If a scene cannot be read or run.
    """
    seconds = {}
    for scene in scenes or scene_names():
        chosen = load_scene(scene) if isinstance(scene, str) else scene
        started = time.perf_counter()
        _compile_scene(chosen)
        seconds[chosen.name] = time.perf_counter() - started
    return seconds


def _compile_scene(scene: Scene) -> None:
    from granular.protocol.piston_motion import Motion, driven_height_and_velocity, with_table_arrays
    from granular.run.evaluation import evaluate
    from granular.run.simulation import simulate

    simulate(scene, t_end=_INSTANT, progress=False)
    positions, velocities = scene.initial_positions_and_velocities()
    evaluate(scene, positions, velocities)
    driven = any(stage.is_tabulated for stage in scene.protocol)
    driven_height_and_velocity(with_table_arrays(Motion()) if driven else Motion(), 0.0)
