"""Beds of discs: all sums have their law, energy is conserved, and too near is refused."""

import itertools
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.disc_law import Disc, disc_energy_and_force
from granular.schema.natural_units import Scales
from granular.shared.errors import OutsideError

CONTACT = {"effects.contact": {"modulus": "20 MPa", "restitution": 0.7}}
NO_CONTACT = {"effects.contact": None}


def discs(scene: Scene, **changes: Any) -> Scene:
    walls = scene.effects.walls  # the same as of dipoles
    named = {} if walls is None else {"effects.walls": walls.to_plain()}
    return scene.replace(**{"grains.magnets": "cylinders", **named, **CONTACT, **changes})


def lattice(count: int, columns: int, spacing: float, seed: int = 3) -> np.ndarray:
    """Positions about a square lattice [D]."""
    random = np.random.default_rng(seed)
    grid = np.array([(k % columns + 0.7, k // columns + 0.7) for k in range(count)])
    return grid * spacing + random.uniform(-0.1, 0.1, grid.shape)


def beyond_dipoles(positions: np.ndarray, reach: float, period: float | None = None) -> np.ndarray:
    """Forces on alike discs half as thick as wide less those on dipoles, over that of two at D."""
    shifts = [0.0] if period is None else period * np.arange(-2.0, 3.0)
    force = np.zeros_like(positions)
    for image in itertools.product(shifts, shifts):
        apart = positions[:, None] - positions + np.array(image)
        r = np.hypot(*np.moveaxis(apart, 2, 0))
        near = (r > 0.0) & (r < reach)
        push = np.zeros_like(r)
        push[near] = disc_energy_and_force(r[near], Disc(0.5, 0.5), Disc(0.5, 0.5))[1] / 3.0
        push[near] -= r[near] ** -4.0
        force += ((push / np.where(r > 0.0, r, 1.0))[..., None] * apart).sum(axis=1)
    return force


def dipoles(positions: np.ndarray, reach: float) -> np.ndarray:
    """Forces on dipoles, over that of two at D."""
    apart = positions[:, None] - positions
    r = np.hypot(*np.moveaxis(apart, 2, 0))
    np.fill_diagonal(r, np.inf)
    return np.asarray((np.where(r < reach, r**-5.0, 0.0)[..., None] * apart).sum(axis=1))


def forces(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Forces at these positions [D], over that of two dipoles at D."""
    unit = STRENGTH * Scales.from_grains(scene.grains).force
    return evaluate(scene, positions * scene.grains.species[0].diameter).force / unit


@pytest.mark.long
def test_periodic_cells_have_the_law() -> None:
    """The part beyond dipoles falls as r^-6, so its sum over images converges."""
    scene = Scene.from_plain(
        {
            "name": "cell",
            "grains": {"count": 400, "species": [{"name": "disc", "diameter": "6 mm"}]},
            "cell": {"width": "27 D", "height": "27 D", "sides": "periodic"},
            "effects": {"dipole": {}},
            "pairs": {"method": "mesh", "tolerance": 1e-4},
            "protocol": [{"name": "hold", "kind": "hold", "duration": 1.0}],
        }
    )
    positions = lattice(400, 20, 1.35)
    beyond = forces(discs(scene, **NO_CONTACT), positions) - forces(scene, positions)
    known = beyond_dipoles(positions, 40.0, period=27.0)
    assert np.abs(beyond - known).max() <= 1e-4 * np.abs(known).max()


@pytest.mark.long
def test_a_hard_impact_into_rows_of_discs_stops_the_run_with_its_remedy() -> None:
    """The packaged piston is made for four times as many discs."""
    changes = {
        "grains.count": 92,
        "cell.width": "30 D",
        "piston.height": "12 D",
        "arrangement.height": "11 D",
    }
    scene = load_scene("workshop").replace(**changes)
    with pytest.raises(OutsideError, match=r"let the piston fall from lower down \('piston\.height'"):
        simulate(scene, t_end=0.15, progress=False)
    lighter = simulate(scene.replace(**{"piston.mass": "3.75 kg"}), t_end=0.15, progress=False)
    assert np.isfinite(lighter.dataset["position"].values).all()
