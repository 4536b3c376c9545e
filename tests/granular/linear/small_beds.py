"""Small beds at rest: relaxed by their forces alone, without a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from granular import load_scene
from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.scene.scene import Scene

D = 6e-3


def small_damper(**changes: Any) -> Scene:
    """The packaged damper with 12 grains in a cell of 14 D, under 0.3 kg."""
    return load_scene("damper").replace(
        **{
            "grains.count": 12,
            "cell.width": "14 D",
            "piston.height": "5 D",
            "piston.mass": 0.3,
            "arrangement.height": "4.8 D",
            "output": {"scalars": "1 ms", "frames": "0.1 s"},
        }
        | changes
    )


def relax(bed: BedForces, start: np.ndarray) -> np.ndarray:
    """Lead coordinates near to a stable equilibrium (FIRE, Bitzek et al. 2006) [m]."""
    at, velocity, step, mix, downhill = start.copy(), np.zeros(bed.size), 0.02, 0.1, 0
    for _ in range(20_000):
        force = bed.forces(at) / bed.scales.force
        if np.abs(force).max() < 1e-6:
            break
        if force @ velocity > 0.0:
            downhill += 1
            velocity = (1.0 - mix) * velocity + mix * np.linalg.norm(velocity) * force / np.linalg.norm(force)
            if downhill > 5:
                step, mix = min(1.1 * step, 0.2), 0.99 * mix
        else:
            velocity[:], step, mix, downhill = 0.0, 0.5 * step, 0.1, 0
        velocity += step * force
        move = step * velocity
        at += bed.length * move * min(1.0, 0.05 / np.abs(move).max())
    return at


def at_rest(scene: Scene) -> Equilibrium:
    """Equilibrium that the scene's arrangement relaxes to."""
    bed = BedForces(scene)
    height = None if scene.piston is None else scene.piston.height
    at = relax(bed, bed.coordinates(scene.initial_positions_and_velocities()[0], height))
    return equilibrium_from(scene, bed.positions(at), height if bed.piston is None else float(at[bed.piston]))


def moved(rest: Equilibrium, **changes: Any) -> Scene:
    """Scene of a bed at its equilibrium."""
    height = {} if rest.piston_height is None else {"piston.height": rest.piston_height}
    return rest.scene.replace(**{"arrangement": {"positions": rest.positions.tolist()}} | height | changes)
