"""Work of compression cycles, and harmonic response to a sinusoidal drive."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import Scene, Trajectory, simulate
from granular.observables import (
    harmonic_response,
    hysteresis_cycles,
    hysteresis_energy,
    packing_fraction_series,
    stage_response,
    wall_forces,
)
from granular.observables.forces import piston_force
from granular.observables.harmonics import find_compression_cycles
from granular.shared.errors import InputError

from .conftest import MakeRun


def test_hysteresis_energy_is_the_area_of_an_ellipse() -> None:
    """The ellipse has half axes of 2 m and 3 N. The force is larger during the downward motion."""
    turn = np.linspace(0.0, 2.0 * np.pi, 4001)
    height, force = 5.0 + 2.0 * np.cos(turn), 10.0 + 3.0 * np.sin(turn)
    assert hysteresis_energy(height, force) == pytest.approx(6.0 * np.pi, rel=1e-5)
    assert hysteresis_energy(height[::-1], force[::-1]) == pytest.approx(-6.0 * np.pi, rel=1e-5)
    assert hysteresis_energy(height, 4.0 * height) == pytest.approx(0.0, abs=1e-12)  # an elastic bed


@pytest.mark.parametrize("top", [1.6, 2.3])
def test_hysteresis_energy_of_a_cycle_with_unequal_ends_counts_only_the_common_heights(top: float) -> None:
    """The force is 5 N on the way down from 2 m to 1 m, and 3 N on the way up to a height `top`."""
    down, up = np.linspace(2.0, 1.0, 7), np.linspace(1.0, top, 11)
    height = np.concatenate([down, up])
    force = np.concatenate([np.full(7, 5.0), np.full(11, 3.0)])
    assert hysteresis_energy(height, force) == pytest.approx(2.0 * (min(top, 2.0) - 1.0), rel=1e-12)


def test_compression_cycles_are_separated_despite_pauses_and_noise() -> None:
    leg = np.linspace(2.0, 1.0, 50)
    rest = np.full(20, 2.0)
    height = np.concatenate([rest, leg, leg[::-1], rest, leg, leg[::-1], rest])
    found = find_compression_cycles(height)
    assert [height[one.lowest] for one in found] == [1.0, 1.0]
    assert [(one.start, one.stop) for one in found] == [(20, 119), (139 + 1, 239)]
    jitter = height + 0.002 * np.sin(np.arange(len(height)))
    assert len(find_compression_cycles(jitter)) == 2
    assert len(find_compression_cycles(-np.cos(np.linspace(0.0, 6.0 * np.pi, 500)))) == 2
    assert find_compression_cycles(np.ones(5)) == []
    assert find_compression_cycles(leg) == []
    assert find_compression_cycles(np.array([])) == []


@pytest.fixture(scope="module")
def cycle(small_bed: Scene) -> Trajectory:
    """Return a run of a small bed that is compressed and expanded twice."""
    return simulate(
        small_bed.replace(
            protocol=[
                {"name": "settle", "kind": "hold", "duration": 0.5},
                {"name": "down", "kind": "move", "to": "4 D", "speed": "40 mm/s"},
                {"name": "up", "kind": "move", "to": "6 D", "speed": "40 mm/s"},
                {"name": "down again", "kind": "move", "to": "5 D", "speed": "40 mm/s"},
                {"name": "up again", "kind": "move", "to": "6 D", "speed": "40 mm/s"},
            ]
        ),
        progress=False,
    )


def test_hysteresis_energy_of_a_run_equals_the_external_work(cycle: Trajectory) -> None:
    """The energy balance integrates this work in every step; the records are 1 ms apart."""
    found = hysteresis_cycles(cycle)
    assert found.sizes["cycle"] == 2
    time, work = cycle.dataset["time"].values, cycle.dataset["work"].values
    for k in range(2):
        first = np.flatnonzero(time == float(found["start"][k]))[-1]
        last = np.flatnonzero(time == float(found["stop"][k]))[0]
        spent = work[last] - work[first]
        turned_over = np.abs(np.diff(work[first : last + 1])).sum()
        assert float(found["energy"][k]) == pytest.approx(spent, abs=1e-4 * turned_over)
        assert float(found["energy"][k]) > 0.0
    assert found["lowest"].values == pytest.approx([0.024, 0.030])
    assert found["highest"].values == pytest.approx([0.036, 0.036])
    assert found["energy"].attrs["units"] == "J"


def test_wall_forces_balance_the_weight_and_packing_fraction_follows_from_the_piston_height(
    cycle: Trajectory,
) -> None:
    forces = wall_forces(cycle)
    assert forces.dims == ("time", "wall")
    assert forces["wall"].values.tolist() == ["left", "right", "bottom", "piston"]
    np.testing.assert_array_equal(forces.sel(wall="piston"), piston_force(cycle))
    np.testing.assert_array_equal(forces.sel(wall="left"), cycle.dataset["left_force"])
    # At rest the bottom supports the piston force and the weight of the grains.
    settled = int(np.searchsorted(cycle.dataset["time"].values, 0.49))
    weight = 23 * 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0 * 9.8
    difference = forces.sel(wall="bottom") - forces.sel(wall="piston")
    assert float(difference[settled]) == pytest.approx(weight, rel=2e-2)
    packing = packing_fraction_series(cycle)
    height = cycle.dataset["piston_height"].values
    np.testing.assert_allclose(packing * height, 23 * np.pi * 0.003**2 / 0.09, rtol=1e-12)


def test_wall_forces_of_a_scene_without_walls_are_refused(make_run: MakeRun) -> None:
    run = make_run(np.zeros((1, 3, 2)), {"effects.walls": None})
    with pytest.raises(InputError, match="no walls"):
        wall_forces(run)
    with pytest.raises(InputError, match="piston force"):
        hysteresis_cycles(run)
    with pytest.raises(InputError, match="3 or more are needed"):
        hysteresis_energy(np.ones(2), np.ones(2))


def test_harmonics_of_a_synthetic_response_are_recovered_exactly() -> None:
    """The phase of the drive, the mean and the drift are arbitrary; samples are unevenly spaced."""
    random = np.random.default_rng(2)
    time = np.sort(random.uniform(3.0, 9.0, 2000))
    turn = 2.0 * np.pi * 2.5 * time + 1.1
    drive = 7.0 + 4.0 * np.cos(turn)
    answer = (
        -3.0
        + 0.2 * time
        + 0.8 * np.cos(turn - 0.6)
        + 0.12 * np.cos(2.0 * turn + 2.0)
        + 0.04 * np.cos(3.0 * turn - 3.0)
    )
    found = harmonic_response(time, drive, answer, 2.5, discard=1.0)
    assert found.harmonics.tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.ratio, [0.2, 0.03, 0.01], rtol=1e-10)
    np.testing.assert_allclose(found.phase, [-0.6, 2.0, -3.0], rtol=1e-10)
    assert found.drive_amplitude == pytest.approx(4.0, rel=1e-10)
    assert found.periods == 12
    assert found.ratio_error.max() < 1e-10


def test_steady_response_of_a_linear_oscillator_has_the_textbook_amplitude_and_phase() -> None:
    """The oscillator is M z'' + c z' + k z = F sin(wt)."""
    mass, damping, stiffness, frequency, force = 2.0, 3.0, 500.0, 2.0, 10.0
    omega = 2.0 * np.pi * frequency
    time = np.arange(0.0, 50.0, 0.002)
    motion = solve_ivp(
        lambda t, s: [s[1], (force * np.sin(omega * t) - damping * s[1] - stiffness * s[0]) / mass],
        (0.0, 50.0),
        [0.3, 0.0],
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
        method="DOP853",
    )
    found = harmonic_response(time, force * np.sin(omega * time), motion.y[0], frequency)
    wanted = 1.0 / (stiffness - mass * omega**2 + 1j * damping * omega)
    assert found.ratio[0] == pytest.approx(abs(wanted), rel=1e-5)
    assert found.phase[0] == pytest.approx(np.angle(wanted), abs=1e-5)
    assert found.ratio[1:].max() < 1e-5 * found.ratio[0]


def test_a_transient_increases_the_standard_error_of_a_harmonic_response() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    drive = np.sin(2.0 * np.pi * 2.0 * time)
    answer = drive * (1.0 + np.exp(-time))
    early = harmonic_response(time, drive, answer, 2.0, discard=0.0)
    late = harmonic_response(time, drive, answer, 2.0, discard=8.0)
    assert early.ratio_error[0] > 30.0 * late.ratio_error[0]
    assert late.ratio[0] == pytest.approx(1.0, abs=1e-3)


def test_standard_errors_of_a_harmonic_response_agree_with_the_scatter_of_repeated_records() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    turn = 2.0 * np.pi * 3.0 * time
    drive = np.sin(turn)
    found = []
    for seed in range(100):
        noise = np.random.default_rng(seed).normal(0.0, 0.5, len(time))
        answer = 2.0 * np.sin(turn - 0.5) + 0.4 * np.sin(2.0 * turn) + noise
        found.append(harmonic_response(time, drive, answer, 3.0, 2, discard=0.0))
    for value, error in (("ratio", "ratio_error"), ("phase", "phase_error")):
        scatter = np.std([getattr(one, value) for one in found], axis=0)
        stated = np.sqrt(np.mean([getattr(one, error) ** 2 for one in found], axis=0))
        # The standard deviation of 300 values has a relative standard error of 4 %, of 100 values 7 %.
        np.testing.assert_allclose(stated / scatter, 1.0, atol=0.16)
    assert np.mean([one.ratio[0] for one in found]) == pytest.approx(2.0, abs=0.01)
    assert np.mean([one.phase[0] for one in found]) == pytest.approx(-0.5, abs=0.005)


def test_harmonic_response_refuses_invalid_records() -> None:
    time = np.arange(0.0, 2.0, 0.01)
    wave = np.sin(2.0 * np.pi * time)
    with pytest.raises(InputError, match="2 complete periods"):
        harmonic_response(time, wave, wave, 1.0, discard=0.0)
    with pytest.raises(InputError, match="samples per period"):
        harmonic_response(time, wave, wave, 20.0)
    with pytest.raises(InputError, match="amplitude of 0"):
        harmonic_response(time, np.zeros(200), wave, 5.0, discard=0.0)
    with pytest.raises(InputError, match="shapes"):
        harmonic_response(time, wave[1:], wave, 5.0)
    with pytest.raises(InputError, match="not finite"):
        harmonic_response(np.nan * time, wave, wave, 5.0)
    with pytest.raises(InputError, match="discard = -1 s"):
        harmonic_response(time, wave, wave, 5.0, discard=-1.0)
    with pytest.raises(InputError, match="time decreases"):
        harmonic_response(time[::-1], wave, wave, 5.0)


@pytest.fixture(scope="module")
def bed_under_oscillation(small_bed: Scene) -> Scene:
    return small_bed.replace(
        **{
            "effects.drag.coefficient": "1 kg/s",
            "protocol": [
                {"name": "settle", "kind": "hold", "duration": 0.5},
                {
                    "name": "oscillation",
                    "kind": "oscillate",
                    "amplitude": "0.1 D",
                    "frequency": "4 Hz",
                    "duration": 3.0,
                },
            ],
        }
    )


def test_bed_under_an_oscillating_piston_responds_as_a_damped_spring(bed_under_oscillation: Scene) -> None:
    """The force rises as the piston descends.

    Drag makes the force lead the displacement, so the bed absorbs energy.
    """
    run = simulate(bed_under_oscillation, progress=False)
    found = stage_response(run)
    assert found.attrs["stage"] == "oscillation"
    assert found.attrs["periods"] == 6
    assert found.attrs["drive_amplitude"] == pytest.approx(0.6e-3, rel=1e-6)
    assert found["ratio"].attrs["units"] == "N/m"
    phase = float(found["phase"][0])
    assert -np.pi < phase < -0.5 * np.pi
    # The work per period, pi F z sin(angle by which -F leads z), agrees with the energy ledger.
    data = run.dataset
    lag = float(found["ratio"][0]) * np.sin(phase) * 0.6e-3**2 * np.pi
    time, work = data["time"].values, data["work"].values
    last = np.interp([2.5, 3.5], time, work)
    assert -lag == pytest.approx((last[1] - last[0]) / 4.0, rel=2e-2)
    with pytest.raises(InputError, match="unknown driven stage 'settle'"):
        stage_response(run, "settle")


def test_harmonic_response_of_a_run_without_a_drive_is_refused(make_run: MakeRun) -> None:
    with pytest.raises(InputError, match="0 stages with a sinusoidal drive; add a stage"):
        stage_response(make_run(np.zeros((1, 3, 2))))


@pytest.mark.long
def test_response_to_a_sinusoidal_push_agrees_with_period_and_damping_of_the_free_motion(
    damper: Scene,
) -> None:
    """The released piston has a period of 0.288 s and a damping ratio of 0.037; the drive has 3 Hz."""
    run = simulate(
        damper.replace(
            **{
                "protocol": [
                    {"name": "rest", "kind": "free", "until": "rest"},
                    {
                        "name": "push",
                        "kind": "push",
                        "amplitude": "4 N",
                        "frequency": "3 Hz",
                        "duration": "8 s",
                    },
                ],
                "output.record": None,
            }
        ),
        progress=False,
    )
    found = stage_response(run)
    own, omega = 2.0 * np.pi / 0.288, 6.0 * np.pi
    wanted = 1.0 / (7.5 * (own**2 - omega**2 + 2j * 0.037 * own * omega))
    # The period is known to 1 %, and with it own^2 - omega^2 to about 8 %.
    assert found["ratio"].attrs["units"] == "m/N"
    assert float(found["ratio"][0]) == pytest.approx(abs(wanted), rel=0.08)
    assert float(found["phase"][0]) == pytest.approx(np.angle(wanted), abs=0.05)
    assert float(found["ratio"][1]) < 0.1 * float(found["ratio"][0])
