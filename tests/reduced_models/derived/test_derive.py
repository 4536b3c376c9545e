"""The law derived from a bed's equilibrium: its eigenvalue, its motion compared with simulations, and
instabilities of the bed.
"""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, Trajectory, damper, equilibrium, load_scene, simulate
from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium, find_equilibrium_pencil
from granular.shared.errors import InputError
from reduced_models import PistonRecord, derive, load_model
from reduced_models.__main__ import main
from reduced_models.derived.derive import (
    RESOLUTION,
    HeldState,
    fit_polynomial_law_values_and_text,
    held_states_and_first_instability,
)
from reduced_models.derived.motion_error import motion_error
from reduced_models.laws.linearization import SmallOscillation, small_oscillation

LIFT = 1e-4  # [m]
SETTLE = {
    "protocol": [{"kind": "free", "name": "drop", "until": "rest", "window": 0.3}],
    "output.record": "drop",
}


def released(rest: Equilibrium, lift: float, duration: float, out: Path | None = None) -> Trajectory:
    """Return a run of given duration [s] that starts from an equilibrium with the piston lifted [m]."""
    plain = rest.scene.to_plain()
    plain["protocol"] = [
        {"kind": "lift", "name": "lift", "by": lift},
        {"kind": "free", "name": "release", "duration": duration},
    ]
    plain["arrangement"] = {"positions": rest.positions.tolist()}
    plain["piston"]["height"] = rest.piston_height
    plain["output"]["record"] = "release"
    return simulate(Scene.from_plain(plain), out=out, progress=False)


def start_error(model, record: PistonRecord, start: tuple[float, float], cycles: int) -> float:
    """Return the error of a motion with a given initial height and velocity [m, m/s].

    The rms error over some cycles from a record's first time is relative to the rms displacement.
    """
    kept = record.time <= record.time[0] + cycles * model.at_rest.period
    time, height = record.time[kept], record.height[kept]
    difference = model.simulate(time, *start).height - height
    return float(np.sqrt((difference**2).mean() / ((height - model.at_rest.height) ** 2).mean()))


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Trajectory:
    return released(
        equilibrium(damper(count=48, drop=24.0, drag=1.0).replace(**SETTLE)),
        LIFT,
        2.3,
        tmp_path_factory.mktemp("runs") / "bed",
    )


@pytest.fixture(scope="module")
def model(run):
    return derive(run)


def test_small_motion_of_the_derived_law_has_the_exact_eigenvalue_of_the_bed(run, model) -> None:
    root = piston_roots(equilibrium(run))[0]
    swing = small_oscillation(model.law, list(model.parameters.values()), model.at_rest.height)
    assert isinstance(swing, SmallOscillation)
    assert 1.0 / swing.period == pytest.approx(root.frequency, rel=1e-6)
    assert swing.damping_ratio == pytest.approx(root.damping_ratio, rel=1e-6)


def test_stiffness_of_the_derived_law_is_the_derivative_of_its_force(model) -> None:
    height, force, stiffness = np.array([state[:3] for state in model.states]).T
    slope = np.polyder(np.poly1d(np.polyfit(height - height[4], force, 6)))
    assert slope(height - height[4]) == pytest.approx(stiffness, rel=1e-7)


def test_the_derived_law_predicts_the_simulated_motion_after_a_release(model) -> None:
    assert model.error.relative < 1e-3
    assert abs(model.error.mean_shift) < 1e-4 * LIFT
    assert model.quality.relative == model.error.relative


def test_derived_motion_after_a_jump_starts_from_the_projection_on_the_piston_mode(run, model) -> None:
    record = run.piston("release")
    projected, plain = (
        start_error(model, record, start, 8) for start in (model.initial, (float(record.height[0]), 0.0))
    )
    assert projected < 4e-3
    assert plain > 0.05


def test_frequency_and_damping_of_the_derived_law_at_an_amplitude_agree_with_long_simulated_motions(
    model,
) -> None:
    conservative = {name: 0.0 if name[0] == "c" else value for name, value in model.parameters.items()}
    undamped = dataclasses.replace(model, parameters=conservative)
    time = np.linspace(0.0, 20.0 * model.at_rest.period, 4001)
    motion = undamped.simulate(time, model.at_rest.height + 5.0 * LIFT, 0.0)
    middle = 0.5 * (motion.height.max() + motion.height.min())
    upward = np.flatnonzero((motion.height[:-1] < middle) & (motion.height[1:] >= middle))
    late = (middle - motion.height[upward]) / (motion.height[upward + 1] - motion.height[upward])
    crossings = time[upward] + late * time[1]
    counted = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    curve = model.backbone([0.5 * float(np.ptp(motion.height))])
    frequency = float(curve.frequency[0]) / (2.0 * np.pi)
    assert frequency * model.at_rest.period < 0.9999
    assert frequency == pytest.approx(counted, rel=1e-6)


def test_damping_ratio_against_amplitude_agrees_with_weakly_damped_cycles(model) -> None:
    size, period = 5.0 * LIFT, model.at_rest.period
    nearly = {name: 1e-4 * value if name[0] == "c" else value for name, value in model.parameters.items()}
    motion = dataclasses.replace(model, parameters=nearly).simulate(
        np.linspace(0.0, 50.0 * period, 50_001), model.at_rest.height + size, 0.0
    )
    tops = [float(motion.height[k : k + 1000].max()) for k in range(1000, 50_000, 1000)]
    decay = -np.polyfit(np.arange(len(tops)), np.log(np.array(tops) - model.at_rest.height), 1)[0]
    curve = model.backbone([0.5 * float(np.ptp(motion.height))])
    assert decay / (2.0 * np.pi) == pytest.approx(1e-4 * float(curve.damping_ratio[0]), rel=0.02)


def test_a_saved_derived_model_is_loaded_with_the_same_text_and_motion(model, tmp_path) -> None:
    model.save(tmp_path / "model.json")
    loaded = load_model(tmp_path / "model.json")
    assert str(loaded) == str(model)
    time = np.linspace(0.0, 1.0, 200)
    assert (loaded.predict(time) == model.predict(time)).all()


def test_exported_code_of_a_derived_model_gives_the_same_motion(model) -> None:
    code: dict = {}
    exec(model.numpy_source, code)
    time = np.linspace(0.0, 1.0, 200)
    assert code["simulate"](time) == pytest.approx(model.predict(time), abs=1e-6 * LIFT)


def test_a_derived_law_has_the_given_polynomial_order_and_range(run) -> None:
    model = derive(run, 5e-5, order=2)
    low, high = model.domain["height"]
    assert (high - model.at_rest.height, model.at_rest.height - low) == pytest.approx((5e-5, 5e-5))
    assert [name for name in model.parameters if name != "rest"] == ["m1", "c0", "c1", "k1", "k2"]


def test_derived_law_of_high_order_and_wide_range_predicts_the_run(run) -> None:
    """In an earlier version, powers of z - rest were expanded and lost digits by cancellation.

    The solver then exceeded its maximum number of steps.
    """
    model = derive(run, 1e-3)
    assert "k6" in model.parameters
    assert model.error.relative < 1e-3


def test_error_for_a_range_that_no_polynomial_describes_gives_a_possible_range() -> None:
    """The damping jumps 3 mm below the equilibrium, at a height of 30 mm."""
    states = [
        HeldState(0.03 + x, 500.0 * x, 500.0, 7.5, 20.0 if x < -3e-3 else 10.0, 8j)
        for x in np.linspace(-4e-3, 4e-3, 9)
    ]
    with pytest.raises(InputError, match=r"the damping from 26 to 34 mm .* use reach = 2\.9"):
        fit_polynomial_law_values_and_text(states, 4, None)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reach": 0.0}, "reach = 0 m is outside the limits; give a number above 0"),
        ({"reach": 0.03}, "below the piston's height, 0.02392 m"),
        ({"order": 0}, "order = 0 is outside the limits; give an integer from 1 to 9"),
    ],
)
def test_invalid_options_of_a_derived_law_are_refused(run, options, words) -> None:
    with pytest.raises(InputError, match=words):
        derive(run, **options)


def test_the_law_of_a_bed_without_drag_has_no_damping() -> None:
    heights = np.linspace(0.049, 0.051, 9)
    states = [HeldState(z, 3.0 * (z - 0.05), 3.0, 0.1, 0.0, 5j) for z in heights]
    _, values, accuracy = fit_polynomial_law_values_and_text(states, 4, None)
    assert values["c0"] == 0.0
    assert "damping of order 0, residual 0 %" in accuracy


def test_derived_law_of_a_bed_on_a_machine_is_refused() -> None:
    carried = {"effects.host": {"bodies": [{"mass": 0.5, "stiffness": 600.0}]}}
    scene = damper(count=48, drop=24.0, drag=1.0).replace(**SETTLE, **carried)
    with pytest.raises(InputError, match=r"remove effects\.host"):
        derive(scene)


def test_derived_law_of_a_record_instead_of_a_bed_is_refused(run) -> None:
    with pytest.raises(InputError, match="PistonRecord does not contain a bed; give a scene or a run"):
        derive(run.piston("release"))


def test_command_derive_prints_and_saves_the_model(run, tmp_path, capsys) -> None:
    main(["derive", str(run.path), "--reach", "0.05 mm", "--save", str(tmp_path / "model.json"), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["error"]["relative"] < 1e-3
    assert printed["instabilities"] == []
    assert json.loads((tmp_path / "model.json").read_text()) == printed["model"]


@pytest.mark.long
def test_the_derived_law_predicts_the_packaged_damper_to_a_thousandth() -> None:
    """The limit of a thousandth is for a lift of 20 um. The limits are wider for larger lifts."""
    rest = equilibrium(load_scene("damper"))
    model = derive(load_scene("damper"), 1.2e-3)
    middle = model.states[len(model.states) // 2]
    assert middle.mass - 7.5 == pytest.approx(0.0650, abs=1e-4)
    assert middle.damping == pytest.approx(11.934, abs=1e-3)
    for lift, limit in ((2e-5, 1e-3), (2e-4, 5e-3), (1.2e-3, 3e-2)):
        run = released(rest, lift, 3.5)
        error = motion_error(model, run.piston("release"))
        assert error.relative < limit
        assert abs(error.mean_shift) < 0.01 * lift
        if lift == 2e-5:
            jumped = derive(run, 2e-5)
            assert start_error(jumped, run.piston("release"), jumped.initial, 10) < 2e-3


DIAMETER = 6e-3  # [m]


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    """Return the equilibrium of 30 grains of two sizes, which rearrange if they are compressed by 0.7 D."""
    plain = damper(count=30, drop=26.0, drag=1.0, seed=2).to_plain()
    plain["grains"]["species"] = [
        {"name": "grain", "diameter": DIAMETER, "share": 0.5},
        {"name": "small", "diameter": 0.7 * DIAMETER, "share": 0.5},
    ]
    plain["protocol"] = [{"kind": "free", "name": "drop", "until": "rest", "window": 0.3}]
    plain["output"]["record"] = "drop"
    return equilibrium(Scene.from_plain(plain))


def follow(rest: Equilibrium, step: float, count: int):
    pencil = rest.pencil
    return held_states_and_first_instability(pencil, pencil.bed.piston, piston_roots(rest)[0].s, step, count)


@pytest.fixture(scope="module")
def followed(rest):
    return follow(rest, -1.5e-4, 40)


def test_an_eigenvalue_of_the_stiffness_vanishes_at_an_instability_of_the_compressed_bed(
    rest, followed
) -> None:
    states, found = followed
    assert 0.0 < states[-1].height - found.height < 1.5e-4
    _, finer = follow(rest, -5e-5, 120)
    assert finer.height == pytest.approx(found.height, abs=3.0 * RESOLUTION * DIAMETER)
    assert set(finer.grains) == set(found.grains)
    assert finer.force_drop == pytest.approx(found.force_drop, rel=0.01)
    assert found.force_drop > 0.1


def test_the_lowest_eigenvalue_falls_to_zero_as_at_a_fold_bifurcation(rest, followed) -> None:
    """Near it, the lowest eigenvalue is proportional to the square root of the distance."""
    _, found = followed
    bed, piston = rest.pencil.bed, rest.pencil.bed.piston
    pencil, lowest = rest.pencil, []
    distances = np.array([1e-4, 2.5e-5])
    goals = found.height + distances
    for height in (*np.linspace(pencil.at[piston], goals[0], 40)[1:], goals[1]):
        start = pencil.at.copy()
        start[piston] = height
        pencil = find_equilibrium_pencil(bed, start, (piston,))
        lowest.append(pencil.lowest_eigenvalues_and_modes(1, (piston,))[0][0])
    assert lowest[-2] / lowest[-1] == pytest.approx(2.0, rel=0.15)


def test_range_of_the_derived_law_ends_at_an_instability_of_the_bed_and_this_is_printed(rest) -> None:
    model = derive(rest.scene, 5e-3, order=9)
    (found,) = model.instabilities
    assert model.domain["height"][0] > found.height
    printed = " ".join(str(model).split())
    assert f"the range ends at {1e3 * found.height:.5g} mm" in printed
    assert f"drops by {found.force_drop:.3g} N" in printed
