"""Laws of beds that move affinely, relax, yield, become ordered or have dry friction, compared with
closed forms.
"""

import cmath
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint, solve_ivp
from scipy.optimize import newton

from granular import Equilibrium, PistonRecord, equilibrium, load_scene, simulate
from granular.linear import MotionFriction
from reduced_models import FitOptions, fit, roll_out
from reduced_models.identification.candidate_laws import does_frequency_rise
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws.annealing_bed import HARDENING, PLASTIC, STIFFENING, TIME
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_observation, compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.linearization import SmallOscillation, small_oscillation
from reduced_models.laws.rubbing_bed import ELEMENTS, rubbing_bed_with_starts_near
from reduced_models.laws.solution import solve_law
from reduced_models.records.first_guesses import first_guesses
from tests.reduced_models.made import assert_found, made_stroke

LAYERS = 20
MASS, WEIGHT, REST, POWER = 7.5, 9.8, 0.06, 2.5


def column(resistance: float, times: np.ndarray, start: float) -> np.ndarray:
    """Return the height of a piston on massless layers of grains, each with its part of the drag."""
    fraction = resistance / LAYERS

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        places, speed = state[:-1], state[-1]
        strain = np.diff(places, prepend=0.0) * LAYERS / REST
        force = MASS * WEIGHT * strain**-POWER
        moved = (force[:-1] - force[1:]) / fraction
        # Half a layer goes with the piston.
        acceleration = (force[-1] - 0.5 * fraction * speed) / MASS - WEIGHT
        return np.concatenate([moved, [speed, acceleration]])

    places = start * np.arange(1, LAYERS + 1) / LAYERS
    total_duration = (times[0], times[-1])
    first = np.append(places, 0.0)
    found = solve_ivp(rates, total_duration, first, "BDF", times, rtol=1e-5, atol=1e-7)
    return np.asarray(found.y[LAYERS - 1])


def test_piston_on_a_column_of_layers_falls_as_predicted_for_affine_motion() -> None:
    """It falls from twice the equilibrium height. The drag is a third of the drag on all grains."""
    resistance, times, start = 10.0, np.linspace(0.0, 1.0, 500), 2.0 * REST
    known = {"lam": resistance / (6.0 * MASS), "weight": WEIGHT, "rest": REST, "power": POWER}
    law = LAWS["power-law-spring"]
    field = compile_rates(law.equation, (), "math")

    def rates(_: float, state: np.ndarray) -> list[float]:
        z, v = map(float, state)
        return [v, field(z, v, *(known[name] for name in law.parameters))[0]]

    said = solve_ivp(rates, (0.0, 1.0), [start, 0.0], "LSODA", times, rtol=1e-8, atol=1e-10).y[0]
    error = said - column(resistance, times, start)
    assert np.sqrt(np.mean(error**2)) < 0.001 * (start - REST)


OMEGA = math.sqrt(POWER * WEIGHT / REST)


def diffusing_column(lateness: float) -> tuple[float, float]:
    """Return frequency and damping ratio of a piston on a column whose drag R satisfies omega R/k =
    `lateness`.
    """

    def balance(p: complex) -> complex:
        s = p * lateness / OMEGA
        return p * p / OMEGA**2 + cmath.sqrt(s) / cmath.tanh(cmath.sqrt(s))

    root = newton(balance, complex(-OMEGA * lateness / 6.0, OMEGA), tol=1e-12)
    return abs(root), -root.real / abs(root)


def small_oscillation_of_law(name: str, lateness: float) -> SmallOscillation:
    known = {
        "lam": OMEGA * lateness / 6.0,
        "weight": WEIGHT,
        "rest": REST,
        "power": POWER,
        "relaxation": lateness / OMEGA / 15.0,
    }
    law = LAWS[name]
    found = small_oscillation(law, [known[key] for key in law.parameters], REST)
    assert isinstance(found, SmallOscillation)
    return found


@pytest.mark.parametrize("lateness", [0.3, 1.0])
def test_small_oscillation_of_the_relaxing_law_agrees_with_a_diffusive_column(lateness: float) -> None:
    """The error is ten times smaller than with affine drag, which omits the next order of the delay."""
    frequency, ratio = diffusing_column(lateness)

    def errors(name: str) -> list[float]:
        found = small_oscillation_of_law(name, lateness)
        return [abs(2.0 * math.pi / found.period / frequency - 1.0), abs(found.damping_ratio - ratio)]

    near, far = errors("relaxing-column"), errors("power-law-spring")
    assert max(near) < 2e-3
    assert max(near) < 0.1 * max(far)


def motion(name: str) -> np.ndarray:
    """Return the motion from 80 mm. Laws with relaxation have a relaxation time of 0.1 ms."""
    known = {"lam": 1.0, "weight": WEIGHT, "rest": REST, "power": POWER, "relaxation": 1e-4}
    law = LAWS[name]
    field = compile_rates(law.equation, (), "math")
    numbers = [known[key] for key in law.parameters]

    def rates(state: np.ndarray, _: float) -> tuple[float, ...]:
        z, v, *hidden = map(float, state)
        return (v, *field(z, v, *hidden, *numbers))

    start = (0.08, *(0.0 for _ in range(1 + len(law.hidden))))
    return np.asarray(odeint(rates, start, np.linspace(0.0, 1.0, 200), rtol=1e-9, atol=1e-11)[:, 0])


def test_relaxing_column_with_relaxation_switched_off_equals_the_power_law_spring() -> None:
    np.testing.assert_allclose(motion("relaxing-column"), motion("power-law-spring"), atol=2e-5)


LAW = LAWS["elastoplastic-bed"]
TRUE = {"lam": 0.02, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.3, "strength": 0.05}


def values(law: Law, **changes: float) -> list[float]:
    return [(TRUE | changes)[name] for name in law.parameters]


def test_small_oscillation_of_a_bed_has_the_stiffness_of_pressure_and_shear_modulus() -> None:
    found = small_oscillation(LAW, values(LAW), 0.06)
    assert isinstance(found, SmallOscillation)
    omega = math.sqrt(9.8 * (2.5 + 0.3) / 0.06)
    assert found.z == pytest.approx(0.06, rel=1e-9)
    assert found.period == pytest.approx(2.0 * math.pi / omega, rel=1e-9)
    assert found.damping_ratio == pytest.approx(0.02 / omega, rel=1e-6)


def test_elastoplastic_bed_without_shear_modulus_equals_the_power_law_spring() -> None:
    time = np.linspace(0.0, 2.0, 400)
    spring = LAWS["power-law-spring"]
    plain = solve_law(spring, time, 0.08, 0.0, [TRUE[name] for name in spring.parameters], 0.02)
    soft = solve_law(LAW, time, 0.08, 0.0, values(LAW, modulus=1e-12), 0.02)
    np.testing.assert_allclose(soft.z, plain.z, rtol=1e-7)


def test_shear_stress_saturates_at_the_strength_and_dissipates_energy() -> None:
    """Large oscillations decay by yielding alone. Small ones hardly decay, since the bed does not yield."""
    time = np.linspace(0.0, 3.0, 3000)
    far = solve_law(LAW, time, 0.09, 0.0, values(LAW, lam=1e-9), 0.02).z
    near = solve_law(LAW, time, 0.0603, 0.0, values(LAW, lam=1e-9), 0.02).z
    kept = [np.ptp(one[-600:]) / np.ptp(one[:600]) for one in (far, near)]
    assert kept[0] < 0.5
    assert kept[1] > 0.95


ANNEALING = LAWS["annealing-bed"]


def test_small_oscillation_has_the_stiffness_of_the_ordered_bed() -> None:
    """After a long time at rest, the shear modulus has its full value."""
    found = small_oscillation(ANNEALING, values(ANNEALING), 0.06)
    assert isinstance(found, SmallOscillation)
    omega = math.sqrt(9.8 * (2.5 + 0.3 * (1.0 + STIFFENING)) / 0.06)
    assert found.z == pytest.approx(0.06, rel=1e-9)
    assert found.period == pytest.approx(2.0 * math.pi / omega, rel=1e-9)


def rates(z: float, speed: float, w: float, order: float) -> tuple[float, float]:
    """Return the rates of the shear stress and of the order."""
    _, stress, ordering = compile_rates(ANNEALING.equation, (), "numpy")(
        z, speed, w, order, *values(ANNEALING)
    )
    return float(stress), float(ordering)


@pytest.mark.parametrize("order", [0.0, 0.4, 1.0])
def test_order_of_a_bed_raises_its_yield_strength(order: float) -> None:
    strength = 0.05 * (1.0 + HARDENING * order)
    for speed in (-0.7, 0.7):
        assert rates(0.05, speed, -math.copysign(strength, speed), order)[0] == pytest.approx(0.0)
        assert abs(rates(0.05, speed, 0.0, order)[0]) == pytest.approx(
            0.3 * (1.0 + STIFFENING * order) * 0.7 / 0.05
        )


def test_order_of_a_bed_grows_at_rest_and_decreases_with_plastic_strain() -> None:
    assert rates(0.05, 0.0, 0.03, 0.25)[1] == pytest.approx(0.75 / TIME)
    yielding = rates(0.05, -2.0, 0.05 * (1.0 + HARDENING), 1.0)[1]
    assert yielding == pytest.approx(-2.0 / (PLASTIC * 0.05))
    assert rates(0.05, -2.0, 0.0, 1.0)[1] == pytest.approx(0.0)  # elastic


def test_an_ordered_bed_oscillates_faster_than_a_bed_just_released() -> None:
    field, time = compile_rates(ANNEALING.equation, (), "math"), np.linspace(0.0, 0.2, 2000)

    def slopes(state: np.ndarray, _: float) -> tuple[float, ...]:
        return (float(state[1]), *field(*map(float, state), *values(ANNEALING)))

    fresh, ordered = (
        odeint(slopes, [0.06006, 0.0, 0.0, order], time, rtol=1e-9, atol=1e-11)[:, 0] for order in (0.0, 1.0)
    )
    # The lowest point comes after half a period, which goes with the root of the stiffness.
    ratio = math.sqrt((2.5 + 0.3) / (2.5 + 0.3 * (1.0 + STIFFENING)))
    assert ordered.argmin() / fresh.argmin() == pytest.approx(ratio, abs=0.003)
    assert ratio < 0.99


D, NOISE = 6e-3, 2e-6
CASES = ((0.02, 0.2), (0.1, 1.0), (0.6, 1.0))
"""Static coefficients of friction, and lifts of the record that is fitted [D]."""
LOOP = {"c": 0.0, "k": 500.0, "friction": 3.0, "zero": 0.0, "travel": 2e-3, "spread": 1.5}


def test_loss_per_cycle_of_a_bed_with_friction_is_the_sum_over_slip_elements() -> None:
    """Each loses four times its force times the amount by which the amplitude exceeds its travel."""
    law, size = FORCE_LAWS["rubbing-bed"], 8e-3
    field = compile_rates(law.equation, law.inputs, "numpy")
    observe = compile_observation(law.equation, law.inputs, "force", "numpy")
    values = [LOOP[name] for name in law.parameters]

    def rates(time: float, state: np.ndarray) -> list[float]:
        z, speed = size * math.sin(time), size * math.cos(time)
        arguments = (*state[1:], z, speed, *values)
        return [float(observe(*arguments)) * speed, *(float(rate) for rate in field(*arguments))]

    cycle = 2.0 * math.pi
    path = solve_ivp(
        rates, (0.0, 2.0 * cycle), np.zeros(ELEMENTS + 1), t_eval=[cycle, 2.0 * cycle], max_step=0.01
    )
    ends = path.y[0]
    travels = 2e-3 * ((np.arange(ELEMENTS) + 0.5) / ELEMENTS) ** 1.5
    assert ends[1] - ends[0] == pytest.approx(4.0 * 3.0 * (size - travels.mean()), rel=0.02)


def test_start_values_of_a_bed_law_are_near_the_parameters_of_a_known_bed() -> None:
    time = np.linspace(0.0, 2.0, 1000)
    guess = first_guesses(time, 0.06 + 1e-3 * np.exp(-time) * np.cos(22.0 * time))
    known = MotionFriction(40.0, 20.0, 0.3, 3600.0, -2e5, 0.04, 3.5)
    law = rubbing_bed_with_starts_near(known)
    assert law.start is not None
    drawn = law.start(guess, np.random.default_rng(0), 100)
    assert set(drawn) == set(law.parameters)
    assert np.median(drawn["travel"]) == pytest.approx(0.3 / 3600.0, rel=0.05)
    assert np.median(drawn["omega"]) == pytest.approx(7.0 * math.pi, rel=0.05)
    assert np.median(drawn["bend"]) == pytest.approx(-2e5 / 7200.0, rel=0.05)


@pytest.mark.long
def test_parameters_of_the_bed_law_with_friction_are_recovered_from_its_loop() -> None:
    record = made_stroke("rubbing-bed", LOOP | {"c": 5.0}, 8e-3, 1.0, 0.01, np.random.default_rng(0))
    assert_found(fit(record, "rubbing-bed", options=FitOptions(measured="force")), LOOP | {"c": 5.0})


def _release(rest: Equilibrium, static: float, lift: float, seed: int) -> PistonRecord:
    """Return the record of a bed with friction whose piston is lifted from equilibrium [D] and
    released, with noise.
    """
    changes: dict[str, Any] = {
        "arrangement": {"positions": rest.positions.tolist()},
        "piston.height": rest.piston_height,
        "effects.friction": {"static": static, "dynamic": 0.75 * static},
        "protocol": [
            {"kind": "lift", "name": "lift", "by": lift * D},
            {"kind": "free", "name": "release", "duration": 2.5},
        ],
        "output": {"scalars": "1 ms", "frames": "1 s", "record": "release"},
    }
    record = simulate(rest.scene.replace(**changes), progress=False).piston()
    noise = NOISE * np.random.default_rng(seed).normal(size=len(record))
    return PistonRecord(np.asarray(record.time), np.asarray(record.height) + noise)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_law_fitted_to_one_release_predicts_a_release_from_half_the_lift(seed: int) -> None:
    rest = equilibrium(load_scene("damper").replace(**{"arrangement.seed": seed}))
    for static, lift in CASES:
        record, other = _release(rest, static, lift, 1), _release(rest, static, 0.5 * lift, 2)
        assert does_frequency_rise(record)
        displacement = math.sqrt(float(np.mean((np.asarray(other.height) - rest.piston_height) ** 2)))
        laws = (
            ("rubbing-bed", "bouc-wen", "viscous-coulomb")
            if seed == 1 and static != 0.1
            else ("rubbing-bed",)
        )
        own, *others = (roll_out(fit(record, law), other).error / displacement for law in laws)
        print(seed, static, own, others)
        assert own <= 0.05
        assert all(own <= left / 3.0 for left in others)
