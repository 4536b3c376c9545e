"""Discovery of time-dependent terms, of parameters inside terms, and of laws with hidden states."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord, damper, simulate
from granular.shared.errors import GranularError, InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.parametric_terms import ParametricTerms, split_constant_and_open_terms
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.terms import (
    HIDDEN_STATES,
    HiddenState,
    parse_term_expressions,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import estimate_smoothed_motion, make_weak_form
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import made_stroke, moved, noisy

TIME = np.linspace(0.0, 40.0, 2000)
FREQUENCY = 1.7
UNPOLISHED = DiscoveryOptions(polish=0)


def driven(seed: int) -> PistonRecord:
    """Return the motion of z'' = 0.8 sin(1.7 t) - 0.15 z'^3 - 0.3 z z' - z with 1 % noise."""
    z = moved(lambda t, z, v: 0.8 * np.sin(FREQUENCY * t) - 0.15 * v**3 - 0.3 * z * v - z, TIME, 0.5)
    # The time of the drive counts from the first sample, whatever the record's clock shows.
    return noisy(3.0 + TIME, z, 0.01 * z.std(), seed)


def texts(found: Discovery) -> dict[str, float]:
    return {term.text.split("(")[0]: value for term, value in (found.best.terms or {}).items()}


def assert_driven(found: Discovery) -> None:
    assert set(texts(found)) == {"z'**3", "z'*z", "z", "sin"}
    assert texts(found)["sin"] == pytest.approx(0.8, rel=0.02)
    (sine,) = (term for term in found.best.terms or {} if "sin" in term.text)
    assert float(sine.text.removeprefix("sin(").split("*t")[0]) == pytest.approx(FREQUENCY, rel=1e-3)


def test_discovery_finds_an_unknown_sinusoidal_drive_and_its_frequency() -> None:
    """Neither a library nor a drive is given."""
    found = discover(driven(0), "sindy", options=UNPOLISHED)
    assert_driven(found)
    assert any("a drive that no column of the record contains" in note for note in found.notes)


@pytest.mark.long  # the quick test skips polishing
@pytest.mark.parametrize("seed", range(6))
def test_amplitude_and_frequency_of_a_discovered_drive_are_fitted_to_the_motion(seed: int) -> None:
    found = discover(driven(seed), "sindy")
    assert_driven(found)
    assert found.model.parameters["w"] == pytest.approx(FREQUENCY, rel=1e-3)
    assert set((found.best.terms or {}).values()) <= set(found.model.parameters.values())


def test_discovery_finds_the_frequency_of_a_drive_given_as_a_term() -> None:
    terms = ["sin(w*t)", "cos(w*t)"]
    assert_driven(discover(driven(0), "sindy", library="polynomial", terms=terms, options=UNPOLISHED))


def test_discovery_finds_no_drive_in_a_free_decay() -> None:
    """The libraries lack the spring of this decay, so that all residuals are five times the noise."""
    time = TIME[::4]
    z = moved(lambda t, z, v: -0.05 * v - np.tanh(6.0 * z), time, 1.5)
    found = discover(noisy(time, z, 0.005 * z.std()), "sindy", options=UNPOLISHED)
    assert found.best.error > 4.0
    assert not any("drive" in note for note in found.notes)


def test_a_term_with_a_given_function_of_time_has_its_exact_values() -> None:
    (term,) = terms_with_coefficients(parse_term_expressions(["sin(2*t)*z'"])[0]) or ()
    motion = estimate_smoothed_motion(driven(0), HeightLine())
    assert not term.is_total_derivative
    expected = np.sin(2.0 * motion.time) * motion.velocity
    np.testing.assert_allclose(term.values(motion.smooth_state), expected)


FREE = PistonRecord(
    TIME[:800],
    (np.exp(-0.05 * TIME) * np.cos(1.3 * TIME))[:800] + np.random.default_rng(0).normal(0.0, 0.005, 800),
)


@pytest.mark.parametrize("term", ["1/(z - p)", "z'/(z - p)", "(z - p)**1.5", "sqrt(p)*sin(p*z)"])
def test_parameter_values_that_give_a_term_a_pole_within_the_record_are_rejected(term: str) -> None:
    """Such values are rejected although their residuals are smaller."""
    motion = estimate_smoothed_motion(FREE, HeightLine())
    library = terms_with_coefficients(parse_term_expressions(["z + z'"])[0]) or {}
    _, opened = split_constant_and_open_terms([term], None, ())
    terms = ParametricTerms()
    (found,) = terms.fit_open_terms(opened, make_weak_form(motion), list(library))
    (number,) = terms.templates_by_term[found][1].values()
    values = found.values(motion.recorded_state)
    assert np.isfinite(values).all()
    assert not motion.z.min() < number < motion.z.max() or "sin" in term
    assert set(texts(discover(FREE, "sindy", library="physical", degree=1, terms=[term], options=UNPOLISHED)))


def test_a_term_without_a_valid_parameter_value_is_refused() -> None:
    with pytest.raises(InputError, match="no values of p make"):
        discover(FREE, "sindy", library="physical", terms=["log(p)*z"], options=UNPOLISHED)


LAW = LAWS["elastoplastic-bed"]
TRUE = {"lam": 0.8, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.33, "strength": 0.04}
MASS = 7.5


def forced(noise: float) -> PistonRecord:
    """Return the force of a bed on a piston whose height is a sum of two sines, with relative noise."""
    time = np.linspace(0.0, 2.0, 800)
    values = [TRUE[name] for name in LAW.parameters]
    field = compile_rates(LAW.equation, (), "numpy")

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = 9.0, 23.0
        z = 0.06 - 0.012 * np.sin(a * t) - 0.004 * np.sin(b * t)
        return z, -0.012 * a * np.cos(a * t) - 0.004 * b * np.cos(b * t)

    w = solve_ivp(
        lambda t, state: [field(*motion(t), state[0], *values)[1]],
        (0.0, 2.0),
        [0.0],
        "LSODA",
        time,
        rtol=1e-8,
        atol=1e-10,
    ).y[0]
    z, v = motion(time)
    force = MASS * (9.8 + np.asarray(field(z, v, w, *values)[0]))
    random = np.random.default_rng(1)
    force += noise * force.std() * random.normal(size=len(time))
    return PistonRecord(time, z + 1e-7 * random.normal(size=len(time)), force=force)


@pytest.mark.parametrize("state", [one for one in HIDDEN_STATES if len(one.scales) == 1])
def test_hidden_states_solve_their_rate_equations(state: HiddenState) -> None:
    time = np.linspace(0.0, 2.0, 4000)
    z, speed = 0.06 - 0.02 * np.sin(9.0 * time), 9.0
    rates = {
        "yielding strain": lambda w, v, h: -(v + abs(v) * abs(w) * w / 0.1**2) / h,
        "strain that yields as in Dahl's model": lambda w, v, h: -(v + abs(v) * w / 0.1) / h,
        "relaxing strain": lambda w, v, h: -v / h - w / 0.1,
    }[state.name]
    exact = solve_ivp(
        lambda t, w: [rates(w[0], -0.02 * speed * np.cos(speed * t), 0.06 - 0.02 * np.sin(speed * t))],
        (0.0, 2.0),
        [0.0],
        "LSODA",
        time,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    found = state.values_along_motion(time, z, np.array([[0.1]]))[0]
    np.testing.assert_allclose(found, exact, atol=1e-4)


def test_discovery_finds_the_law_of_a_yielding_bed_from_its_force() -> None:
    """The law has pressure, drag, shear stress and a yield strain."""
    options = DiscoveryOptions(polish=0)
    best = discover(forced(0.01), "sindy", library="memory", target="force", options=options).best
    assert best.hidden_state.kind.name == "yielding strain"
    assert best.hidden_state.scales[0] == pytest.approx(TRUE["strength"] / TRUE["modulus"], rel=0.05)
    values = {term.text: value for term, value in (best.terms or {}).items()}
    assert set(values) == {"z**(-5/2)", "u/z**(5/2)", "z'"}
    assert values["u/z**(5/2)"] / values["z**(-5/2)"] == pytest.approx(TRUE["modulus"], rel=0.05)
    assert values["z'"] == pytest.approx(-2.0 * TRUE["lam"] * MASS, rel=0.05)
    assert "w' = -(z' + Abs(z')*Abs(w)*w/0.1" in best.text
    assert best.text.startswith("force = ")


@pytest.mark.parametrize(
    ("law", "truth", "advised"),
    [
        ("bouc-wen", {"c": 40.0, "k": 900.0, "friction": 6.0, "zero": 0.5, "rho": 800.0, "sigma": 1.2}, True),
        ("saturation", {"limit": 12.0, "speed": 0.03, "k": 900.0, "zero": 0.5}, False),
    ],
)
def test_discovery_recommends_hidden_states_if_one_halves_the_misfit(
    law: str, truth: dict[str, float], *, advised: bool
) -> None:
    """Neither test force is a sum of library terms. One force has memory; the other depends on velocity."""
    record = made_stroke(law, truth, 0.01, 1.5, 0.01, np.random.default_rng(1))
    found = discover(record, "sindy", library="physical", target="force", options=UNPOLISHED)
    assert found.best.error > 5.0
    assert any("--library memory" in note for note in found.notes) is advised


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"input": "force"}, "only for an undriven bed"),
        ({"library": ["memory", "rational"]}, "cannot be combined with other libraries"),
        ({"terms": ["q*z"]}, "contains q"),
    ],
)
def test_unsupported_arguments_of_the_library_with_hidden_states_are_refused(
    changes: dict[str, Any], said: str
) -> None:
    options: dict[str, Any] = {"method": "sindy", "library": "memory"} | changes
    with pytest.raises(InputError, match=said):
        discover(forced(0.01), **options)


def test_discovery_of_a_bed_law_from_records_without_force_or_with_negative_heights_is_refused() -> None:
    record = forced(0.01)
    with pytest.raises(GranularError, match="needs a measured force"):
        discover(PistonRecord(record.time, record.height), "sindy", library="memory", target="force")
    with pytest.raises(InputError, match="heights above the floor"):
        discover(PistonRecord(record.time, record.height - 0.06), "sindy", library="memory")


@pytest.mark.long
def test_discovery_from_forces_in_simulated_falls_finds_the_equation_of_the_bed_law() -> None:
    """The Pareto front contains this equation.

    The drag coefficient is within 10 % of the value for grains that follow the piston affinely.
    """

    def fall(height: float) -> PistonRecord:
        stage = {"kind": "free", "name": "drop", "duration": 3.0}
        changes = {
            "piston.height": f"{height} D",
            "arrangement.height": f"{height - 1.0} D",
            "protocol": [stage],
            "output.record": "drop",
        }
        return simulate(damper().replace(**changes), dt="auto*2", progress=False).piston()

    found = discover([fall(20.0), fall(28.0)], "sindy", library="memory", target="force")
    assert found.best.hidden_state.kind.name == "yielding strain"
    law = {"z**(-5/2)", "u/z**(5/2)", "z'"}
    same = [
        one.terms
        for one in found.candidates
        if one.terms is not None and {term.text for term in one.terms} == law
    ]
    values = {term.text: value for term, value in same[0].items()}
    assert values["z'"] == pytest.approx(-368 * 0.1 / 3.0, rel=0.1)
    assert 0.2 < values["u/z**(5/2)"] / values["z**(-5/2)"] < 0.45
