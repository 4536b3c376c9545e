"""Contact: restitution at every speed, energy, momentum, and the search for close pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from granular import Scene, evaluate, load_scene, simulate
from granular.compiled import entry
from granular.pairs import cell_list
from granular.pairs.cell_list import close_pairs_workspace
from granular.pairs.direct_sum import pad_coordinates, pad_values

find_close_pairs = entry(cell_list.find_close_pairs)


def head_on_collision(speed: float, restitution: float, **changes: object) -> Scene:
    return load_scene("bed").replace(
        **{
            "grains.count": 2,
            "effects.dipole": None,
            "effects.walls": None,
            "effects.gravity": None,
            "effects.drag": None,
            "piston": None,
            "effects.contact": {"modulus": 1e7, "restitution": restitution},
            "arrangement.positions": [["10 D", "10 D"], ["11.2 D", "10 D"]],
            "arrangement.velocities": [[speed, 0.0], [-speed, 0.0]],
            **changes,
        }
    )


@pytest.mark.parametrize(
    ("speed", "restitution"),
    [
        *((0.01, 0.2), (0.01, 1.0), (0.5, 0.6)),
        *(pytest.param(*one, marks=pytest.mark.long) for one in ((0.01, 0.6), (0.5, 0.2), (0.5, 1.0))),
    ],
)
def test_restitution_at_every_speed(restitution: float, speed: float) -> None:
    run = simulate(head_on_collision(speed, restitution), "auto/16", 0.003 / speed, progress=False)
    after = run.dataset["velocity"].values[-1, :, 0]
    assert after[1] == pytest.approx(restitution * speed, rel=1e-3)
    assert after[0] == pytest.approx(-after[1], rel=1e-9)
    lost = run.dataset["contact_loss"].values
    assert (np.diff(lost) >= 0.0).all()
    assert run.settings()["ledger_residual"] < 1e-4


SPECIES = [
    {"name": "big", "diameter": 0.006, "share": 0.5},
    {"name": "small", "diameter": 0.004, "share": 0.5},
]


def test_contact_force_is_minus_gradient() -> None:
    scene = load_scene("bed").replace(
        **{"grains.species": SPECIES, "grains.count": 4, "effects.contact.modulus": 1e6}
    )
    place = np.array([[0.05, 0.05], [0.0545, 0.0515], [0.0555, 0.0475], [0.2, 0.05]])
    force = evaluate(scene, place).force
    step = 1e-7
    for grain in range(3):
        for axis in range(2):
            energies = []
            for shift in (-2, -1, 1, 2):
                moved = place.copy()
                moved[grain, axis] += shift * step
                energies.append(evaluate(scene, moved).potential_energy)
            slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * step)
            assert -slope == pytest.approx(force[grain, axis], rel=1e-6)


def test_contact_only_acts_below_the_sum_of_radii(bed: Scene) -> None:

    mixture = bed.replace(**{"grains.species": SPECIES})
    place = mixture.initial_positions_and_velocities()[0]
    touching = mixture.replace(**{"effects.contact.modulus": 1e8})
    assert np.array_equal(evaluate(mixture, place).force, evaluate(touching, place).force)


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(0, 200),
    seed=st.integers(0, 10**6),
    reach=st.floats(0.1, 3.0),
    width=st.floats(0.5, 50.0),
)
def test_close_pairs_are_those_of_a_tree(count: int, seed: int, reach: float, width: float) -> None:
    place = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2)) * [width, 12.0]
    wanted = cKDTree(place).query_pairs(reach, output_type="set") if count else set()
    workspace = close_pairs_workspace(count, len(wanted))
    x, y = pad_coordinates(place)
    find_close_pairs(workspace, x, y, count, reach, None)
    filled = workspace.filled[0]
    found = {
        (min(i, j), max(i, j))
        for i, j in zip(workspace.first[:filled].tolist(), workspace.second[:filled].tolist(), strict=True)
    }
    assert len(found) == filled
    assert found == wanted


def test_too_many_contacts_are_an_error_not_silence() -> None:
    place = np.zeros((40, 2))
    workspace = close_pairs_workspace(40, 40 * 39 // 2 - 1)
    x, y = pad_coordinates(place)
    find_close_pairs(workspace, x, y, 40, 1.0, None)
    assert workspace.filled[0] == -1
    x[3] = np.nan
    find_close_pairs(close_pairs_workspace(40, 780), x, y, 40, 1.0, None)


def test_small_grains_about_a_big_one_have_room() -> None:
    """Hundreds of them lie within the big one's diameter of each other, and three touch."""
    place = 0.11 * np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2)
    radius = np.full(400, 0.056)
    radius[0] = 0.5
    workspace = close_pairs_workspace(400, 16 * 400)
    find_close_pairs(workspace, *pad_coordinates(place), 400, 1.0, pad_values(radius))
    wanted = {
        (min(i, j), max(i, j))
        for i, j in cKDTree(place).query_pairs(1.0, output_type="set")
        if np.hypot(*(place[i] - place[j])) < radius[i] + radius[j]
    }
    filled = workspace.filled[0]
    found = zip(workspace.first[:filled].tolist(), workspace.second[:filled].tolist(), strict=True)
    assert {(min(pair), max(pair)) for pair in found} == wanted


@pytest.mark.long
def test_bed_with_contact_does_not_overlap(small_damper: Scene) -> None:
    """A heavy piston squeezes the bed; contacts keep the grains apart."""
    heavy = small_damper.replace(
        **{"piston.mass": 10.0, "protocol.drop.until": None, "protocol.drop.duration": 0.3}
    )
    bare = simulate(heavy, t_end=0.3, progress=False).dataset["closest_distance"].values.min()
    held = heavy.replace(**{"effects.contact.modulus": 2e9})
    run = simulate(held, t_end=0.3, progress=False)
    assert bare < 0.8 * 0.006
    assert run.dataset["closest_distance"].values.min() > 0.95 * 0.006
    assert run.settings()["ledger_residual"] < 1e-3
