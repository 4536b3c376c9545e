"""Laws of several coordinates, and laws for several measured columns with separate noise."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError, RecordWarning
from reduced_models import FitOptions, Law, Parameter, compare, fit, load_model, roll_out
from tests.reduced_models.made import assert_found, damped_cosine, half_width, moved, noise, noisy

NOISE = 0.01
MASSES = (
    "x'' + c1*x' + k1*x + k2*(x - y) + c2*(x' - y') = 0; mu*y'' + k2*(y - x) + c2*(y' - x') = 0; height = x"
)
POSITIVE = ("k1", "k2", "c1", "c2", "mu")


def two_masses(seed: int) -> tuple[PistonRecord, dict[str, float], np.ndarray]:
    """Return a record of both masses, the parameters, and frequency [Hz] and damping ratio of both modes."""
    random = np.random.default_rng(seed)
    limits = {
        "k1": (300.0, 800.0),
        "k2": (100.0, 600.0),
        "c1": (0.2, 1.5),
        "c2": (0.2, 1.5),
        "mu": (0.3, 1.0),
    }
    truth = {name: random.uniform(*pair) for name, pair in (limits | {"mu": (0.3, 1.0)}).items()}
    k1, k2, c1, c2, mu = truth.values()
    matrix = np.zeros((4, 4))
    matrix[[0, 2], [1, 3]] = 1.0
    matrix[1] = [-(k1 + k2), -(c1 + c2), k2, c2]
    matrix[3] = np.array([k2, c2, -k2, -c2]) / mu
    time = np.linspace(0.0, 3.0, 1500)
    start = [1e-3 * random.uniform(-1.0, 1.0), 0.0, 1e-3 * random.uniform(-1.0, 1.0), 0.0]
    rates, shapes = np.linalg.eig(matrix)
    path = ((shapes * np.linalg.solve(shapes, start)) @ np.exp(np.outer(rates, time))).real
    x, y = (row + NOISE * row.std() * random.normal(size=len(time)) for row in path[::2])
    roots = sorted(rates[rates.imag > 0.0], key=abs)
    modes = np.array([[abs(root) / (2.0 * math.pi), -root.real / abs(root)] for root in roots])
    return PistonRecord(time, x, extra={"second": y}), truth, modes


def misses(model: Any, modes: np.ndarray) -> np.ndarray:
    """Return the errors of frequency and damping ratio of both modes, in half-widths of their intervals."""
    rest, (faster,) = model.at_rest, model.faster_modes
    period, ratio = (0.5 * float(np.diff(rest.intervals[name])[0]) for name in ("period", "damping_ratio"))
    return np.array(
        [
            (1.0 / rest.period - modes[0, 0]) * rest.period**2 / period,
            (rest.damping_ratio - modes[0, 1]) / ratio,
            (faster.frequency - modes[1, 0]) / faster.frequency_error,
            (faster.damping_ratio - modes[1, 1]) / faster.damping_ratio_error,
        ]
    )


def fit_masses(record: PistonRecord, mass: float, *, both: bool, starts: int = 16) -> Any:
    law = Law("two masses", MASSES + "; second = y" * both, positive=POSITIVE)
    return fit(record, law, parameters={"mu": Parameter(mass, fixed=True)}, starts=starts)


@pytest.mark.long  # quick: an acceleration and the base's force of one motion, below
def test_a_law_of_two_observed_masses_is_fitted_and_stored(tmp_path: Any) -> None:
    record, truth, modes = two_masses(4)
    model = fit_masses(record, truth["mu"], both=True, starts=4)
    assert np.abs(misses(model, modes)).max() <= 3.0
    assert_found(model, {name: value for name, value in truth.items() if name != "mu"})
    assert model.quality.relative == pytest.approx(NOISE, rel=0.1)
    assert model.qualities["second"].relative == pytest.approx(NOISE, rel=0.1)
    assert "further mode" in str(model)
    assert "residual of second" in str(model)
    assert roll_out(model, record).relative < 2.0 * NOISE
    with pytest.raises(InputError, match="several coordinates"):
        model.harmonic_cycle(1e-4)
    model.save(tmp_path / "model.json")
    again = load_model(tmp_path / "model.json")
    assert again.qualities == model.qualities
    assert again.faster_modes == model.faster_modes
    np.testing.assert_array_equal(again.simulate_signal(record), model.simulate_signal(record))


@pytest.mark.long
@pytest.mark.parametrize("both", [False, True])
def test_parameters_of_two_masses_are_recovered_from_fifteen_records(both: bool) -> None:
    for seed in range(15):
        record, truth, modes = two_masses(seed)
        assert np.abs(misses(fit_masses(record, truth["mu"], both=both), modes)).max() <= 3.0, seed


def test_acceleration_and_base_force_of_the_same_motion_are_fitted_together() -> None:
    root = complex(-0.8, 20.0)
    acceleration = (1e-3 * root**2 * np.exp(root * TIME)).real
    level = 0.01 * acceleration.std()
    seen = {
        "time": TIME,
        "acceleration": acceleration + noise(2000, level),
        "base_force": -7.5 * (acceleration + noise(2000, 3.0 * level, 1)),
    }
    text = "z'' + 2*lam*z' + k*z = 0; acceleration = z'' + offset; base_force = -m*z''"
    law = Law("both", text, positive=("lam", "k", "m"))
    model: Any = fit(PistonRecord.from_columns(seen), law, starts=2)
    assert_found(model, {"lam": 0.8, "k": abs(root) ** 2, "m": 7.5, "offset": 0.0})
    assert model.quality.relative == pytest.approx(0.01, rel=0.1)
    assert model.qualities["base_force"].relative == pytest.approx(0.03, rel=0.1)


def test_fit_finds_the_frequency_of_a_drive_in_the_equation() -> None:
    time = np.linspace(0.0, 20.0, 4000)
    path = moved(lambda t, z, v: 0.3 * math.sin(7.3 * t) - 0.4 * v - 30.0 * z, time, 0.01)
    model = fit(noisy(time, path, 0.01 * path.std(), 1), "z'' + c*z' + k*z = a*sin(w*t)")
    for name, value in {"c": 0.4, "k": 30.0, "a": 0.3, "w": 7.3}.items():
        assert abs(abs(model.parameters[name]) - value) <= 3.0 * half_width(model, name), name


def test_missing_columns_and_a_single_noise_value_for_several_columns_are_refused() -> None:
    record, *_ = two_masses(0)
    with pytest.raises(RecordError, match="third"):
        fit(record, "z'' + c*z' + k*z = 0; third = a*z")
    law = Law("two masses", MASSES + "; second = y", positive=POSITIVE)
    with pytest.raises(InputError, match="give noise as a mapping"):
        fit(record, law, noise=1e-6)
    with pytest.raises(InputError, match="remove the argument measured"):
        fit(record, law, options=FitOptions(measured="height"))


def test_the_origin_of_the_observed_height_is_arbitrary() -> None:
    record = noisy(TIME, 0.06 + damped_cosine(TIME), 1e-5)
    model: Any = fit(record, "z'' + 2*lam*z' + om**2*z = 0; height = off - 2*z", starts=6)
    assert model.parameters["off"] == pytest.approx(0.06, abs=1e-5)
    assert abs(model.parameters["om"]) == pytest.approx(abs(complex(0.8, 21.8)), rel=1e-3)
    assert model.quality.converged == 6
    assert model.predict(TIME)[0] == pytest.approx(0.061, abs=2e-5)


@pytest.mark.long
def test_a_simulation_of_two_masses_starts_from_their_equilibrium() -> None:
    text = "z'' + c1*z' + k1*(z - a) = k3*(y - z); y'' + c2*y' + k2*(y - z) = 0; height = z; q = y"
    known = {"c1": 0.5, "k1": 400.0, "a": 0.05, "k3": 80.0, "c2": 0.6, "k2": 300.0}

    def rates(_: float, s: np.ndarray) -> list[float]:
        pull = known["k3"] * (s[2] - s[0])
        first = pull - known["c1"] * s[1] - known["k1"] * (s[0] - known["a"])
        return [s[1], first, s[3], -known["c2"] * s[3] - known["k2"] * (s[2] - s[0])]

    time = np.linspace(0.0, 3.0, 1200)
    path = solve_ivp(rates, (0.0, 3.0), [0.051, 0.0, 0.0505, 0.0], t_eval=time, rtol=1e-10, atol=1e-13).y
    record = PistonRecord(time, path[0], extra={"q": path[2]})
    model: Any = fit(record, text, parameters=known, starts=4, test_fraction=0.0)
    assert model.parameters["k1"] == pytest.approx(400.0, rel=1e-3)
    moved = model.free_decay(1e-4, 3.0)
    assert np.abs(moved.height - 0.05).max() < 1.1e-4
    with pytest.raises(InputError, match="several coordinates"):
        model.harmonic_cycle(1e-4)


LAW = Law("tension", "z'' + 2*lam*z' + k*z = 0; height = z; tension = s*z + t0", positive=("lam", "k"))
LAW = Law("tension", "z'' + 2*lam*z' + k*z = 0; height = z; tension = s*z + t0", positive=("lam", "k"))
TIME = np.linspace(0.0, 4.0, 2000)
NOISES = {"height": 2e-5, "tension": 0.3}


def spring(outlier: float = 0.0) -> PistonRecord:
    """Return the record of an oscillation of 1 mm with the tension of its spring [N] and 10 % outliers."""
    z = damped_cosine(TIME, 1e-3, 0.4, 20.0)
    tension = 500.0 * z + 512.0 + noise(2000, 0.3, 1) + np.where(np.arange(2000) % 10 == 7, outlier, 0.0)
    return noisy(TIME, z, 2e-5, extra={"tension": tension})


@pytest.fixture(scope="module")
def plain() -> Any:
    """Return the fit of the spring.

    Other fits here have the same number of starts to share its compiled code.
    """
    return fit(spring(), LAW, starts=2)


def test_known_noise_of_several_columns_gives_the_same_intervals_as_estimated_noise(plain: Any) -> None:
    """One signal has a large offset."""
    known = fit(spring(), LAW, noise=NOISES, starts=2)
    for model in (plain, known):
        assert_found(model, {"s": 500.0})
    assert half_width(known, "s") == pytest.approx(half_width(plain, "s"), rel=0.2)


def test_a_robust_loss_uses_the_noise_of_each_column() -> None:
    model = fit(spring(2.0), LAW, noise=NOISES, loss="huber", starts=2)
    assert model.parameters["t0"] == pytest.approx(512.0, abs=0.1)  # 512.2 by least squares


@pytest.mark.parametrize(
    ("law", "level", "words"),
    [
        (LAW, {"height": 2e-5, "tensoin": 0.3}, "no column 'tensoin' is observed, and 'tension' is"),
        (LAW, {"tension": 0.3}, "'height' is missing"),
        ("linear", {"height": 2e-5}, "defines no observed column; give a number"),
    ],
)
def test_noise_of_unobserved_columns_is_refused(law: Law | str, level: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        fit(spring(), law, noise=level)


def test_prediction_of_an_observed_column_is_compared_with_a_piston_at_rest() -> None:
    """For the piston at rest, the mean of the signal is used. A record without the column is refused."""
    record, text = spring(), "z'' + 2*lam*z' + k*z = 0; tension = s*z + t0"
    model: Any = fit(record, text, parameters={"s": Parameter(500.0, fixed=True)}, starts=2)
    assert roll_out(model, record).at_rest == pytest.approx(1.0)
    with pytest.raises(RecordError, match="needs the column 'tension'"):
        roll_out(model, PistonRecord(record.time, record.height))


def test_laws_are_compared_on_the_same_columns() -> None:
    """The errors of all columns count."""
    with pytest.raises(
        InputError, match=r"different columns of the record \(tension: height, tension; linear: height\)"
    ):
        compare(spring(), [LAW, "linear"])
    (row,) = compare(spring(), LAW, starts=2).rows
    model: Any = row.models[0]
    errors = [model.quality.test_error, model.qualities["tension"].test_error]
    assert row.error == pytest.approx(math.sqrt(np.mean(np.square(errors))))
    assert row.parameters == 4


def test_an_equilibrium_height_that_is_held_is_not_counted_as_a_free_parameter() -> None:
    time = np.linspace(0.0, 4.0, 1000)
    stroke = 0.03 + 5e-3 * np.sin(6.0 * time)
    pressure = 3.0 * 0.03e-3 * np.cos(6.0 * time) - 2.0 * (0.03 / stroke) ** 3
    record = PistonRecord(time, stroke, force=pressure + noise(1000, 0.01, 2))
    text = "force = c*z' - load*(rest/z)**power"
    law = Law("pressure", text, positive=("load", "rest", "power"), given="rest")
    (row,) = compare(record, law, starts=2).rows
    assert row.models[0].parameters["rest"] == pytest.approx(0.03, rel=0.02)
    assert row.parameters == 3


def test_columns_keep_a_common_time_zero_if_one_is_clipped_at_the_start() -> None:
    """The position sensor does not reach the release height; the tension is recorded completely."""
    record = spring()
    limited = PistonRecord(TIME, np.minimum(record.height, 0.9e-3), extra=record.extra)
    with pytest.warns(RecordWarning, match="begins at the limit of its sensor"):
        model = fit(limited, LAW, starts=2)
    assert_found(model, {"lam": 0.4, "k": 0.4**2 + 20.0**2, "s": 500.0}, 1.0)
    assert model.quality.residual == pytest.approx(2e-5, rel=0.1)
