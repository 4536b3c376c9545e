"""The trend test on series with a known trend, and on integrations that gain, lose or conserve energy."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from granular import Trajectory, simulate
from granular.shared.errors import InputError
from validation import exact_solution
from validation.energy_drift import EnergyRun, energy_trend, run_energy_study, variable_step_bounce_run
from validation.hard_case import energy_change, head_on_collision

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

LENGTH = 1600
TIME = np.arange(float(LENGTH))
SEEDS = 400
Noise = Callable[[np.random.Generator], np.ndarray]


def white(random: np.random.Generator) -> np.ndarray:
    return random.standard_normal(LENGTH)


def correlated(random: np.random.Generator) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -0.98], random.standard_normal(LENGTH)))


def walk(random: np.random.Generator) -> np.ndarray:
    return random.standard_normal(LENGTH).cumsum()


def oscillation(random: np.random.Generator) -> np.ndarray:
    return np.sin(2.0 * math.pi * (TIME / random.uniform(5.0, 45.0) + random.uniform()))


def oscillation_and_walk(random: np.random.Generator) -> np.ndarray:
    return oscillation(random) + 0.02 * walk(random)


def bounces(random: np.random.Generator) -> np.ndarray:
    """Return the energy error of a bouncing grain, which consists of short spikes."""
    period = random.uniform(15.0, 45.0)
    return np.exp(-((TIME % period - 0.5 * period) ** 2) / 8.0)


NOISES: tuple[Noise, ...] = (white, correlated, walk, oscillation, oscillation_and_walk, bounces)


@pytest.mark.parametrize("noise", NOISES)
def test_the_energy_trend_test_has_its_stated_rate_of_false_alarms(noise: Noise) -> None:
    """The rate is measured over 400 seeds. If it is 5 %, more than 33 alarms occur once in 1500 tests."""
    alarms = sum(
        energy_trend(TIME, noise(np.random.default_rng(seed))).p_value < 0.05 for seed in range(SEEDS)
    )
    assert alarms <= 33


@pytest.mark.parametrize("noise", [white, oscillation, bounces])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_trend_beyond_the_oscillation_is_detected(noise: Noise, sign: float) -> None:
    drift = sign * 20.0 * TIME / LENGTH
    found = [energy_trend(TIME, noise(np.random.default_rng(k)) + drift) for k in range(50)]
    wanted = "gains" if sign > 0.0 else "loses"
    assert all(one.verdict() == wanted for one in found)
    covered = sum(one.interval[0] <= sign * 20.0 / LENGTH <= one.interval[1] for one in found)
    assert covered >= 48


def test_a_trend_within_a_random_walk_is_detected() -> None:
    drift = 30.0 * math.sqrt(LENGTH) * TIME / LENGTH
    found = [energy_trend(TIME, walk(np.random.default_rng(k)) + drift) for k in range(50)]
    assert all(one.verdict() == "gains" for one in found)


def test_plain_linear_regression_would_often_report_a_false_energy_trend() -> None:
    """Least squares assume independent samples."""
    from scipy import stats

    alarms = sum(
        stats.linregress(TIME, walk(np.random.default_rng(seed))).pvalue < 0.05 for seed in range(100)
    )
    assert alarms > 80


def acceleration(y: float) -> float:
    return 0.5 * y**-3.5 - 0.05


def energy(y: float, v: float) -> float:
    return 0.5 * v * v + 0.2 * y**-2.5 + 0.05 * y


def verlet(y: float, v: float, h: float) -> tuple[float, float]:
    v += 0.5 * h * acceleration(y)
    y += h * v
    return y, v + 0.5 * h * acceleration(y)


def symplectic_euler(y: float, v: float, h: float) -> tuple[float, float]:
    v += h * acceleration(y)
    return y + h * v, v


def explicit_euler(y: float, v: float, h: float) -> tuple[float, float]:
    return y + h * v, v + h * acceleration(y)


def runge_kutta(y: float, v: float, h: float) -> tuple[float, float]:
    a1 = acceleration(y)
    v2, a2 = v + 0.5 * h * a1, acceleration(y + 0.5 * h * v)
    v3, a3 = v + 0.5 * h * a2, acceleration(y + 0.5 * h * v2)
    v4, a4 = v + h * a3, acceleration(y + h * v3)
    return y + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)


@pytest.mark.parametrize(
    ("step", "h", "wanted"),
    [
        (verlet, 0.3, "none"),
        (symplectic_euler, 0.05, "none"),
        (explicit_euler, 0.02, "gains"),
        (runge_kutta, 0.3, "loses"),
    ],
)
def test_the_energy_trend_distinguishes_integrators(
    step: Callable[[float, float, float], tuple[float, float]], h: float, wanted: str
) -> None:
    y, v, energies = 5.0, 0.0, []
    for _ in range(40_000):
        y, v = step(y, v, h)
        energies.append(energy(y, v))
    found = energy_trend(h * np.arange(len(energies)), np.array(energies))
    assert found.verdict() == wanted


def test_unsuitable_series_are_refused() -> None:
    with pytest.raises(InputError, match="4 or more samples each"):
        energy_trend(TIME[:50], TIME[:50])
    with pytest.raises(InputError, match="not finite"):
        energy_trend(TIME, np.full(LENGTH, math.nan))
    with pytest.raises(InputError, match="give increasing times"):
        energy_trend(-TIME, TIME)


def test_a_constant_energy_shows_no_trend() -> None:
    found = energy_trend(TIME, np.full(LENGTH, 3.0))
    assert found.verdict() == "none"
    assert found.rate == pytest.approx(0.0, abs=1e-15)


LIMIT = 1e-6


def collide(dt: float | str, method: str) -> Trajectory:
    problem = head_on_collision(0.02)
    return simulate(problem.scene, dt, problem.time, method, progress=False)


def test_variable_steps_require_at_most_a_fifth_of_the_force_calls_of_fixed_steps_in_a_collision() -> None:
    """Both methods evaluate the forces once per step. The closest distance of the pair is 0.02 D."""
    time, count = head_on_collision(0.02).time, 1400
    assert energy_change(collide(time / count, "stormer-verlet")) > 1e3 * LIMIT
    while energy_change(collide(time / count, "stormer-verlet")) > LIMIT:
        count = round(1.03 * count)
    coarse, finer = (collide(dt, "adaptive-verlet") for dt in ("auto*8", "auto*6"))
    assert energy_change(coarse) < LIMIT
    assert int(coarse.settings()["steps"]) <= count / 5
    assert energy_change(finer) < 0.2 * energy_change(coarse)


def test_the_energy_over_ten_thousand_bounces_has_no_trend() -> None:
    """A bounce has about 160 steps, whose length varies by a factor of fifteen."""
    found = run_energy_study(variable_step_bounce_run())
    assert found.stopped is None
    assert found.steps > 1e6
    assert found.trend.verdict() == "none"
    assert abs(found.trend.total_drift) < 0.1 * found.trend.swing
    assert np.abs(found.errors).max() < 0.01


@pytest.mark.long
def test_the_trend_test_detects_the_energy_loss_of_a_method_within_few_bounces() -> None:
    scene = exact_solution.bounce_problem().scene
    time = 100.0 * float(exact_solution.bounce_period(scene))
    records = {"output.scalars": time / 2048, "output.frames": time}
    found = run_energy_study(EnergyRun("bounces", scene.replace(**records), "runge-kutta-4", 1e-3, time))
    assert found.trend.verdict() == "loses"
