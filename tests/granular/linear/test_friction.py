"""Dry friction during the piston's motion, compared with analytical results and simulations."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from granular import Trajectory, equilibrium, evaluate, load_scene, simulate
from granular.linear import MotionFriction, motion_friction
from granular.linear.equilibrium import Equilibrium, find_equilibrium_pencil
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, small_damper

DRAG = 0.3
LIFTS, COEFFICIENTS = (0.2, 0.5, 1.0), (0.01, 0.02, 0.05)  # [D], mu_s


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    """Return a bed of twelve magnets at equilibrium."""
    return at_rest(small_damper(**{"effects.drag.coefficient": DRAG}))


def test_friction_loads_and_stiffness_agree_with_equilibria_at_slightly_different_piston_heights(
    rest: Equilibrium,
) -> None:
    found = motion_friction(rest, static=0.02)
    bed, at, step = rest.pencil.bed, rest.pencil.at, 1e-3 * D
    assert bed.piston is not None
    sides = []
    for way in (-1.0, 1.0):
        start = at.copy()
        start[bed.piston] += way * step
        sides.append(find_equilibrium_pencil(bed, start, (bed.piston,)).at)
    moved = (sides[1] - sides[0]) / (2.0 * step)
    rubbing = rest.scene.replace(**{"effects.friction": {"static": 0.02, "dynamic": 0.015}})
    loads = evaluate(rubbing, rest.positions, piston_height=rest.piston_height).normal_load
    slides = np.hypot(moved[:12], moved[12:24])
    assert found.load == pytest.approx(loads.sum(), rel=1e-12)
    assert found.moving_load == pytest.approx(loads @ slides, rel=1e-5)
    assert found.force == pytest.approx(0.015 * found.moving_load, rel=1e-12)
    pushes = [bed.forces(side)[bed.piston] for side in sides]
    assert found.stiffness == pytest.approx((pushes[0] - pushes[1]) / (2.0 * step), rel=1e-4)
    assert found.bending == pytest.approx(-(pushes[0] + pushes[1]) / step**2, rel=1e-2)


def test_normal_loads_on_the_grains_agree_with_the_pair_sum_by_de_paula(rest: Equilibrium) -> None:
    across = rest.positions[:, None] - rest.positions[None]
    distance = np.hypot(*across.transpose(2, 0, 1)) + np.where(np.eye(12), np.inf, 0.0)
    found, half = (
        motion_friction(rest, static=0.02),
        rest.scene.replace(**{"effects.friction.tilt": "aligned"}),
    )
    thickness, gap = 3e-3, 3.1e-3
    lean = math.atan(thickness / D)
    tilt = math.asin(gap / math.hypot(D, thickness)) - lean
    factor = 0.75 * D * math.cos(tilt) * math.sin(tilt) / (math.cos(lean + tilt) * math.hypot(D, thickness))
    loads = rest.pencil.bed.scales.force * factor * (D / distance) ** 3
    assert found.load == pytest.approx(loads.sum(), rel=1e-9)
    aligned = motion_friction(Equilibrium(half, rest.positions, rest.piston_height, 0.0, True, rest.pencil))
    assert aligned.moving_load == pytest.approx(0.5 * found.moving_load, rel=1e-9)


def test_friction_on_the_grains_and_on_the_piston_are_both_included(rest: Equilibrium) -> None:
    with pytest.raises(InputError, match="has no friction"):
        motion_friction(rest)
    scene = rest.scene.replace(
        **{"effects.friction": {"static": 0.5, "dynamic": 0.4}, "piston.friction": "0.25 N"}
    )
    found = motion_friction(Equilibrium(scene, rest.positions, rest.piston_height, 0.0, True, rest.pencil))
    assert found.force == pytest.approx(0.4 * found.moving_load + 0.25, rel=1e-12)
    assert found.guide_force == 0.25
    assert found.sticking_amplitude * found.stiffness == pytest.approx(2.8 * found.moving_load, rel=1e-12)


@pytest.fixture
def straight() -> MotionFriction:
    """Return a friction force of 0.36 N on a spring of constant stiffness 3600 N/m."""
    return MotionFriction(40.0, 20.0, 0.36, 3600.0, 0.0, 0.04, 3.5)


def test_amplitudes_of_sticking_and_of_equal_loss_by_drag_and_friction_have_analytical_values(
    straight: MotionFriction,
) -> None:
    assert straight.sticking_amplitude == pytest.approx(0.7e-3)
    assert straight.equivalent_damping_ratio(straight.drag_amplitude) == pytest.approx(0.04)
    # Friction dissipates 4 F_c a per cycle, drag 2 pi zeta k a^2.
    loss = 2.0 * math.pi * straight.equivalent_damping_ratio(2e-3) * 3600.0 * 2e-3**2
    assert loss == pytest.approx(4.0 * 0.36 * 2e-3)
    assert "grains stick below 0.7 mm" in str(straight)


def test_turning_points_with_friction_on_a_linear_spring_agree_with_the_closed_form(
    straight: MotionFriction,
) -> None:
    found = np.abs(straight.turning_points(-2e-3, 3))
    decay, f = math.exp(-2.0 * math.pi * 0.04 / math.sqrt(1.0 - 0.04**2)), 1e-4
    for before, after in itertools.pairwise(found):
        assert (after + f) ** 2 == pytest.approx(decay * (before - f) ** 2 + 4.0 / 3.0 * f**2, rel=1e-9)
    # Finally sliding does not reach the floor: a stroke is 2 F_c/k or shorter.
    strokes = np.abs(np.diff(straight.turning_points(2e-3, 100)))
    assert len(strokes) < 20
    assert strokes[-1] >= 2e-4


def test_piston_friction_alone_reduces_the_amplitude_per_cycle_by_four_times_friction_over_stiffness() -> (
    None
):
    guide = MotionFriction(0.0, 0.0, 0.36, 3600.0, 0.0, 0.0, 3.5, guide_force=0.36)
    np.testing.assert_allclose(
        guide.turning_points(9.5e-4, 9), [9.5e-4, -7.5e-4, 5.5e-4, -3.5e-4, 1.5e-4, 5e-5]
    )
    assert "stick" not in str(guide)
    assert "no drag acts" in str(guide)


def test_strong_drag_without_friction_gives_the_decrement_for_its_damping_ratio() -> None:
    drag = MotionFriction(0.0, 0.0, 0.0, 3600.0, 0.0, 0.4, 3.5)
    found = drag.turning_points(1e-3, 1)[1]
    assert found == pytest.approx(-1e-3 * math.exp(-math.pi * 0.4 / math.sqrt(1.0 - 0.4**2)), rel=1e-9)


def test_turning_points_on_a_nonlinear_spring_without_losses_conserve_energy() -> None:
    free = MotionFriction(0.0, 0.0, 0.0, 3600.0, -2e5, 0.0, 3.5)
    up, down = free.turning_points(6e-3, 1)
    energies = [1800.0 * z**2 - 2e5 / 6.0 * z**3 for z in (up, down)]
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)
    assert -up < down < 0.0
    with pytest.raises(InputError, match="too large for the cubic expansion"):
        free.turning_points(-60e-3, 1)


def _run(rest: Equilibrium, static: float, lift: float) -> Trajectory:
    """Simulate a bed with friction whose piston is lifted by `lift` [m] from equilibrium and released."""
    changes: dict[str, Any] = {
        "arrangement": {"positions": rest.positions.tolist()},
        "piston.height": rest.piston_height,
        "effects.friction": {"static": static, "dynamic": 0.75 * static},
        "protocol": [
            {"kind": "lift", "name": "lift", "by": lift},
            {"kind": "free", "name": "release", "duration": 2.5},
        ],
        "output": {"scalars": "1 ms", "frames": "4 ms", "record": "release"},
    }
    return simulate(rest.scene.replace(**changes), progress=False)


def _turning_points(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return indices and heights of the turning points of a record, including its first sample."""
    slope = np.diff(height)
    turns = np.flatnonzero(slope[:-1] * slope[1:] < 0.0) + 1
    return np.append(0, turns), height[np.append(0, turns)]


@pytest.mark.long
@pytest.mark.parametrize("name", ["damper", "magnets"])
def test_predicted_turning_points_with_friction_agree_with_simulations(name: str) -> None:
    walls = {f"effects.walls.{side}": "experimental" for side in ("left", "right", "bottom", "top")}
    bed = equilibrium(load_scene(name).replace(**walls))
    judged = 0
    for static in COEFFICIENTS:
        found = motion_friction(bed, static)
        slip = found.force / found.stiffness
        for lift in LIFTS:
            run = _run(bed, static, lift * D)
            start = run.stage("release").start
            record = run.piston()
            turns, heights = _turning_points(np.asarray(record.height))
            halves = 0.5 * np.abs(np.diff(heights))
            halves = halves[: int((halves > 3.0 * slip).sum())]
            said = 0.5 * np.abs(np.diff(found.turning_points(lift * D, len(halves))))
            # Strokes above 7 F_c/k agree within 5 %, above 3 F_c/k within 15 %. At 1 D the disordered bed of
            # discs dissipates 7 % more by drag than the root predicts, even without friction.
            above = 0.1 if (name, static, lift) == ("magnets", 0.01, 1.0) else 0.05
            limits = np.where(halves > found.sticking_amplitude, above, 0.15)
            assert (np.abs(said / halves - 1.0) < limits).all(), (static, lift, said / halves)
            # In the first half-oscillation the bed already slides, without a previous turning point.
            times, frames = np.asarray(record.time), run.dataset["frame_time"].values - start
            still = ~run.dataset["velocity"].values.any(axis=2)
            loads = run.dataset["normal_load"].values
            share = (still * loads).sum(axis=1) / loads.sum(axis=1)
            for k in np.flatnonzero(said < found.sticking_amplitude):
                if k:
                    inside = (frames >= times[turns[k]]) & (frames < times[turns[k + 1]])
                    assert share[inside].mean() > 0.1, (static, lift, k)
                    judged += 1
    assert judged >= 4
