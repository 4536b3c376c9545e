"""The configurational temperature of a run, and what adds nothing to a Laplacian."""

import numpy as np
import pytest

from granular import load_scene
from granular.observables import configurational_temperature
from granular.observables.forces import iterate_pair_forces, iterate_wall_forces
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal


def test_that_of_a_run_is_that_of_its_frames(make_run: MakeRun) -> None:
    """With the forces that dipoles and walls make."""
    frames = 0.012 * (hexagonal(6, 5) + 2.0) + np.random.default_rng(2).normal(scale=4e-4, size=(3, 30, 2))
    changes = {"effects.gravity": None, "effects.drag": None}
    scene = make_run(frames, changes).scene
    forces = np.zeros_like(frames)
    for total, places in zip(forces, frames, strict=True):
        for some in (*iterate_pair_forces(scene, places), iterate_wall_forces(scene, places, 0.36)):
            total[some.grains] += some.forces.sum(axis=1)
    run = make_run(frames, changes, forces=forces)
    heights, forces = (run.dataset[name].values for name in ("frame_height", "force"))
    assert configurational_temperature(scene, frames, heights, forces) == pytest.approx(
        configurational_temperature(scene, frames, 0.36), rel=1e-12
    )
    with pytest.raises(InputError, match="0 frames"):
        configurational_temperature(scene, frames[:0], 0.36, forces[:0])
    with pytest.raises(InputError, match=r"piston_height has the shape \(2,\)"):
        configurational_temperature(scene, frames, np.ones(2))
    with pytest.raises(InputError, match="forces have the shape"):
        configurational_temperature(scene, frames, 0.36, forces[0])


def test_friction_and_weight_add_nothing_to_the_laplacian() -> None:
    scene = load_scene("bed").replace(**{"grains.count": 2, "arrangement.height": "19 D"})
    places = 0.006 * np.array([[20.0, 9.0], [30.0, 9.0]])
    bare = scene.replace(**{"effects.gravity": None})
    frames, forces = places[None], np.ones((1, 2, 2))
    whole, part = (configurational_temperature(some, frames, forces=forces) for some in (scene, bare))
    assert whole == part > 0.0
    touching = scene.replace(**{"effects.contact": {"modulus": "1 GPa"}})
    with pytest.raises(InputError, match="only dipoles and walls"):
        configurational_temperature(touching, frames, forces=forces)
