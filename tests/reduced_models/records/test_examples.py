"""Example and simulated records: the parameters of their motions are recovered."""

import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from granular.records.options import ReadOptions, write_record_description
from granular.shared.errors import InputError
from reduced_models import Parameter, PistonRecord, fit, identify
from reduced_models.records.example_records import (
    DYNAMOMETER,
    DYNAMOMETER_TESTS,
    EXAMPLES,
    PLATFORM,
    RING_DOWN,
    simulate_platform_decay,
    simulate_ring_down,
    write_example_records,
)
from reduced_models.records.sources import read_record
from tests.reduced_models.made import assert_found

pytestmark = pytest.mark.filterwarnings("ignore::granular.shared.errors.RecordWarning")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with all examples."""
    directory = tmp_path_factory.mktemp("lab")
    assert set(write_example_records(directory)) == {f"{name}.csv" for name in EXAMPLES}
    return directory


def test_existing_examples_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "driven.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=r"driven\.toml already exists in"):
        write_example_records(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["driven.toml"]


def test_example_files_are_reproducible(lab: Path, tmp_path: Path) -> None:
    write_example_records(tmp_path)
    for path in lab.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_example_description_is_read(name: str, lab: Path) -> None:
    record = read_record(lab / f"{name}.toml")
    assert len(record) > 1000
    assert (record.coordinate_unit == "rad") == (name in ("encoder", "pendulum"))
    forced = ("driven", "force-stroke", *(f"dynamometer-{test}" for test in DYNAMOMETER_TESTS))
    assert (record.force is not None) == (name in forced)


VOLTS = ("--scale", "2.4894 mm/V", "--zero", "2.513 V")


def test_a_record_in_volts_is_identified_with_only_its_scale(lab: Path, command: Callable[..., Any]) -> None:
    done = command("reduced_models", "identify", str(lab / "lvdt.csv"), *VOLTS, "--law", "linear")
    assert done.returncode == 0, done.stderr
    for name, value in (("natural frequency", 4.1), ("damping ratio", 5.0)):
        found = re.search(rf"{name} +\w+ +([0-9.]+)", done.stdout)
        assert float(found[1]) == pytest.approx(value, rel=0.02 if value == 5.0 else 1e-3)


def test_written_description_contains_the_calibration(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    written = tmp_path / "record.toml"
    words = ("look", str(lab / "lvdt.csv"), *VOLTS, "--write", str(written))
    assert command("reduced_models", *words).returncode == 0
    assert np.array_equal(read_record(written).height, read_record(lab / "lvdt.toml").height)


def test_the_rest_before_the_release_in_the_lvdt_example_is_omitted_with_a_warning(lab: Path) -> None:
    with pytest.warns(UserWarning, match=r"is at rest until 0\.40"):
        assert read_record(lab / "lvdt.toml").time[0] == pytest.approx(0.4, abs=0.005)


def test_a_file_with_laser_and_accelerometer_gives_the_true_motion_and_acceleration(lab: Path) -> None:
    record = read_record(lab / "accelerometer.toml")
    found = fit(record, "linear").at_rest
    assert 1.0 / found.period == pytest.approx(6.0, rel=1e-3)
    assert found.damping_ratio == pytest.approx(0.03, rel=0.02)
    omega = 2.0 * np.pi * 6.0
    assert record.extra["accelerometer"][0] == pytest.approx(-3e-3 * omega**2 / 9.80665, abs=0.01)


def test_force_and_stroke_of_a_damper_give_its_drag_and_stiffness(lab: Path) -> None:
    record = read_record(lab / "force-stroke.toml")
    assert record.force is not None
    speed = np.gradient(record.height, record.time)
    columns = np.stack([speed, record.height], axis=1)
    drag, stiffness = np.linalg.lstsq(columns, record.force, rcond=None)[0]
    assert drag == pytest.approx(120.0, rel=1e-3)
    assert stiffness == pytest.approx(900.0, rel=2e-3)


def test_the_law_of_the_dynamometer_records_is_recovered(lab: Path) -> None:
    records = [read_record(lab / f"dynamometer-{test}.toml") for test in DYNAMOMETER_TESTS]
    model, *_ = fit(records, "bouc-wen", starts=2)
    assert_found(model, DYNAMOMETER, widths=1.0)
    friction = DYNAMOMETER["friction"]
    for cycle in model.cycles:
        size, omega = cycle.amplitude, cycle.frequency
        viscous = math.pi * DYNAMOMETER["c"] * omega * size**2
        # Friction that builds up over 1/rho loses a little less than its full force over the whole stroke.
        assert 0.6 < (cycle.energy - viscous) / (4.0 * friction * size) < 1.0


def test_a_damping_ratio_of_1e_4_is_determined_despite_a_drifting_zero(lab: Path) -> None:
    model = fit(read_record(lab / "ring-down.csv"), "linear", starts=2)
    assert RING_DOWN["damping_ratio"] == pytest.approx(model.at_rest.damping_ratio, rel=0.005)
    low, high = model.at_rest.intervals["damping_ratio"]
    assert low <= RING_DOWN["damping_ratio"] <= high
    assert high - low < 1e-6
    # The drift is part of the fit, so it does not blur the other parameters.
    assert not any("lam" in direction.powers for direction in model.undetermined)


def test_a_real_pendulum_is_identified_with_dry_friction(lab: Path) -> None:
    """Source and licence are in the file.

    The encoder has 4000 counts per turn, so eleven counts are one degree.
    """
    head = (lab / "pendulum.csv").read_text(encoding="utf-8").splitlines()[:28]
    assert any("https://github.com/" in line for line in head)
    assert any("Permission is hereby granted" in line for line in head)
    found = fit(read_record(lab / "pendulum.toml"), "pendulum-coulomb", starts=2)
    assert found.parameters["omega"] == pytest.approx(10.96, rel=2e-3)
    assert found.parameters["friction"] == pytest.approx(2.0, rel=0.1)
    assert found.quality.relative < 0.012


NUMBER, LEAST = 60, 54
REST, ZERO = 0.06, 2.513
"""Equilibrium height of a piston over its floor [m], and voltage at the floor [V]."""


class Made(NamedTuple):
    """A simulated record: its description, its true parameters, and start and end of each motion [s]."""

    path: Path
    words: str
    frequency: float
    ratio: float
    noise: float
    releases: list[tuple[float, float]]


def free_motion(times: np.ndarray, top: float, omega: float, ratio: float, power: float | None) -> np.ndarray:
    """Height and velocity (2, n) of a free motion from rest at the top."""
    from scipy.integrate import solve_ivp

    def rate(_time: float, state: np.ndarray) -> tuple[float, float]:
        z, v = state
        if power is None:
            return v, -2.0 * ratio * omega * v - omega**2 * (z - REST)
        weight = omega**2 * REST / power
        return v, -2.0 * ratio * omega * v + weight * ((REST / z) ** power - 1.0)

    end = float(times[-1])
    solved = solve_ivp(rate, (0.0, end), (top, 0.0), "DOP853", times, rtol=1e-10, atol=1e-13)
    return np.asarray(solved.y)


def lift(times: np.ndarray, start: np.ndarray, top: float, frequency: float) -> np.ndarray:
    """Return heights (n,) of a piston that is stopped and lifted to the top by hand."""
    z, v = start
    part, stopped = times / times[-1], 0.1 / frequency
    left = z + v * stopped * (1.0 - np.exp(-times / stopped)) * (1.0 - part) ** 2
    return np.asarray(left + (top - z) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2))


def make(directory: Path, number: int) -> Made:
    """Write a record and its description, determined by a seed, and return them."""
    random = np.random.default_rng([0, number])
    frequency, ratio = np.exp(random.uniform(np.log([1.0, 0.01]), np.log([12.0, 0.12])))
    samples, cycle_count, noise = random.uniform([50.0, 8.0, 0.005], [150.0, 20.0, 0.03])
    power = None if random.uniform() < 0.5 else float(random.uniform(1.5, 4.0))
    sensor = str(random.choice(["V", "counts"] if power else ["V", "counts", "deg"]))
    hold = max(0.0, float(random.uniform(-0.5, 2.0)))
    clipped, lost, several = random.uniform(size=3) < 0.3
    step, size = 1.0 / (frequency * samples), float(random.uniform(2e-3, 8e-3))
    parts: list[np.ndarray] = []
    releases, state = [], None
    for again in range(3 if several else 1):
        top = REST + size * (random.uniform(0.8, 1.1) if again else 1.0)
        if state is not None:
            times = step * np.arange(1, int(random.uniform(0.3, 0.6) / step) + 1)
            parts.append(lift(times, state, top, frequency))
        held = hold * random.uniform(0.5, 2.0) if again else hold
        parts.append(np.full(int(held / step), top))
        times = np.arange(0.0, cycle_count / frequency, step)
        begin = step * sum(map(len, parts))
        releases.append((begin, begin + float(times[-1])))
        motion = free_motion(times, top, 2.0 * math.pi * frequency, ratio, power)
        parts.append(motion[0])
        state = motion[:, -1]
    height = np.concatenate(parts)
    time = step * np.arange(len(height))
    height += random.normal(0.0, noise * size, len(height))
    if clipped:
        level = size * random.uniform(0.6, 0.9)
        height = np.clip(height, REST - level if random.uniform() < 0.5 else 0.0, REST + level)
    slope = 2.5e-3 * random.uniform(0.5, 2.0)  # m/V
    step_size = size / random.uniform(200.0, 2000.0)  # m a count
    head, cells, options = {
        "V": ("lvdt [V]", np.round(ZERO + height / slope, 6),
              {"scale": f"{1e3 * slope!r} mm/V", "zero": f"{ZERO} V"}),
        "counts": ("encoder [counts]", np.round(1024.0 + height / step_size),
                   {"scale": f"{1e3 * step_size!r} mm/counts", "zero": "1024 counts"}),
        "deg": ("angle [deg]", np.round((height - REST) * 30.0 / size, 6), {}),
    }[sensor]  # fmt: skip
    texts = [f"{cell:.9g}" for cell in cells]
    gone = random.uniform(size=len(texts)) < (0.05 if lost else 0.0)
    how = str(random.choice(["", "-9999", "no row"]))
    rows = [
        f"{t:.9g},{how if away else text}"
        for t, text, away in zip(time, texts, gone, strict=True)
        if not (away and how == "no row")
    ]
    path = directory / f"made{number}.csv"
    path.write_text("\n".join([f"time [s],{head}", *rows, ""]))
    write_record_description(path.with_suffix(".toml"), path, ReadOptions(**options))
    words = (
        f"{'linear' if power is None else 'power law'}, {frequency:.2f} Hz, {100 * ratio:.2f} %, {sensor}, "
        f"hold {hold:.2f} s, noise {100 * noise:.1f} %, {cycle_count:.0f} swings of {samples:.0f} samples"
        + f"{', clipped' * bool(clipped)}{', lost' * bool(lost)}{', three releases' * bool(several)}"
    )
    return Made(path.with_suffix(".toml"), words, float(frequency), float(ratio), float(noise), releases)


@pytest.mark.parametrize("numbers", [range(8), pytest.param(range(8, NUMBER), marks=pytest.mark.long)])
def test_motion_is_found_in_simulated_records(numbers: range, tmp_path: Path) -> None:
    """The motion lasts from a release until it is lost in the noise, and does not include the next lift."""
    for number in numbers:
        made = make(tmp_path, number)
        motion = read_record(made.path)
        start, end = min(made.releases, key=lambda release: abs(release[0] - motion.time[0]))
        period = 1.0 / made.frequency
        late = 0.4 if "clipped" in made.words else 0.1
        assert -0.1 < (motion.time[0] - start) / period < late, made.words
        assert motion.time[-1] < end + 0.1 * period, made.words
        seen = math.log(1.0 / made.noise) / (2.0 * math.pi * made.ratio)
        assert (motion.time[-1] - start) / period > min((end - start) / period - 2.5, 0.6 * seen), made.words


def judge(made: Made, laws: list[str] | None = None) -> tuple[bool, str]:
    """Return fitted frequency and damping ratio as text, and whether they are correct."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = identify(made.path, laws=laws, progress=False)
    frequency = next(figure for figure in found.figures if figure.name == "natural frequency")
    ratio = next(figure for figure in found.figures if figure.name.startswith("damping ratio"))
    off = frequency.value / made.frequency - 1.0
    wrong = abs(ratio.value - 100.0 * made.ratio)
    missed = ratio.value / (100.0 * made.ratio) - 1.0
    good = abs(off) < 2e-3 and (abs(missed) < 0.03 or wrong < ratio.total_error)
    said = f"{100 * off:+.3f} %, {100 * missed:+.2f} %, {found.best.law.name}: {made.words}"
    return good, said if good else f"{said}; {[str(one.message) for one in caught]}"


@pytest.mark.parametrize("number", [0, pytest.param(10, marks=pytest.mark.long)])
def test_the_linear_law_is_identified_in_simulated_records(number: int, tmp_path: Path) -> None:
    good, said = judge(make(tmp_path, number), ["linear"])
    assert good, said


@pytest.mark.long
def test_most_simulated_records_are_identified(tmp_path: Path) -> None:
    outcomes = [judge(make(tmp_path, number)) for number in range(NUMBER)]
    for good, said in outcomes:
        print("right " if good else "MISSED", said)
    assert sum(good for good, _ in outcomes) >= LEAST
    assert all("; [" in said and "; []" not in said for good, said in outcomes if not good)


@pytest.mark.long
def test_linear_and_quadratic_damping_of_decay_tests_lie_within_their_intervals() -> None:
    law = f"{PLATFORM['mass']}*z'' + B1*z' + B2*z'*Abs(z') + K*(z - rest) = 0"
    covered = dict.fromkeys(("B1", "B2"), 0)
    for seed in range(20):
        random = np.random.default_rng(seed)
        records = [PistonRecord(*simulate_platform_decay(size, random).values()) for size in (1.0, 2.0, 4.0)]
        model = fit(records, law, parameters={"rest": Parameter(per_record=True)})[0]
        for name in covered:
            low, high = model.intervals[name]
            covered[name] += low <= PLATFORM[name] <= high
    assert min(covered.values()) >= 18, covered


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::granular.shared.errors.CautionWarning")
@pytest.mark.parametrize("rate", [50.0, 25.0])
def test_intervals_of_ring_downs_contain_the_damping_ratio(rate: float) -> None:
    """At least 12 of 15 intervals of 95 % must contain it; by chance this fails in 0.5 % of tests."""
    covered = 0
    for seed in range(1, 16):
        columns = simulate_ring_down(np.random.default_rng(seed), rate=rate, drift=0.0)
        low, high = fit(PistonRecord(*columns.values()), "linear", starts=2).at_rest.intervals[
            "damping_ratio"
        ]
        covered += low <= RING_DOWN["damping_ratio"] <= high
    assert covered >= 12
