"""Contact between grains: coefficient of restitution, energy, momentum, and search for close pairs."""

import numpy as np
import pytest

from granular import Scene, load_scene, simulate


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
def test_coefficient_of_restitution_is_the_same_at_every_impact_speed(
    restitution: float, speed: float
) -> None:
    run = simulate(head_on_collision(speed, restitution), "auto/16", 0.003 / speed, progress=False)
    after = run.dataset["velocity"].values[-1, :, 0]
    assert after[1] == pytest.approx(restitution * speed, rel=1e-3)
    assert after[0] == pytest.approx(-after[1], rel=1e-9)
    lost = run.dataset["contact_loss"].values
    assert (np.diff(lost) >= 0.0).all()
    assert run.settings()["ledger_residual"] < 1e-4


@pytest.mark.long
def test_contact_forces_limit_the_overlap_of_grains_under_a_heavy_piston(small_damper: Scene) -> None:
    heavy = small_damper.replace(
        **{"piston.mass": 10.0, "protocol.drop.until": None, "protocol.drop.duration": 0.3}
    )
    bare = simulate(heavy, t_end=0.3, progress=False).dataset["closest_distance"].values.min()
    held = heavy.replace(**{"effects.contact.modulus": 2e9})
    run = simulate(held, t_end=0.3, progress=False)
    assert bare < 0.8 * 0.006
    assert run.dataset["closest_distance"].values.min() > 0.95 * 0.006
    assert run.settings()["ledger_residual"] < 1e-3
