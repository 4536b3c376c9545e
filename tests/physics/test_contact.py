"""Contact: restitution at every speed, energy, momentum, and the search for close pairs."""

from __future__ import annotations

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate


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


@pytest.mark.parametrize(("speed", "restitution"), [(0.01, 0.2), (0.01, 1.0), (0.5, 0.6)])
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
