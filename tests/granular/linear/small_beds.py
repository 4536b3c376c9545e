"""Small beds at equilibrium, relaxed by their forces without a simulation."""

from typing import Any

import numpy as np

from granular import load_scene
from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import RELAXED, Equilibrium, equilibrium_from, relax_until_forces_reduced
from granular.linear.pencil import make_pencil
from granular.scene.scene import Scene

D = 6e-3


def small_damper(**changes: Any) -> Scene:
    """Return the packaged damper with 12 grains in a cell 14 D wide, and a piston of 0.3 kg."""
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


def at_rest(scene: Scene) -> Equilibrium:
    """Return the equilibrium reached by relaxation from the scene's initial arrangement."""
    bed = BedForces(scene)
    height = None if scene.piston is None else scene.piston.height
    start = bed.coordinates(scene.initial_positions_and_velocities()[0], height)
    at = relax_until_forces_reduced(bed, start, (), make_pencil(bed, start).stiffness.diagonal(), RELAXED)
    return equilibrium_from(scene, bed.positions(at), height if bed.piston is None else float(at[bed.piston]))


def free_motion(rest: Equilibrium, displacement: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the displacement of the piston [m] at times [s] after release, as a sum over eigenvalues."""
    pencil, size = rest.pencil, rest.pencil.bed.size
    inverse_mass = np.linalg.inv(pencil.mass.toarray())
    rates = np.block(
        [
            [np.zeros((size, size)), np.eye(size)],
            [-inverse_mass @ pencil.full_stiffness, -inverse_mass @ pencil.full_damping],
        ]
    )
    roots, shapes = np.linalg.eig(rates)
    amplitudes = np.linalg.solve(shapes, np.concatenate([displacement, np.zeros(size)]).astype(complex))
    return np.real(np.exp(np.outer(times, roots)) @ (shapes[pencil.bed.piston] * amplitudes))


def moved(rest: Equilibrium, **changes: Any) -> Scene:
    """Return a scene that starts from the equilibrium of a bed."""
    height = {} if rest.piston_height is None else {"piston.height": rest.piston_height}
    return rest.scene.replace(**{"arrangement": {"positions": rest.positions.tolist()}} | height | changes)
