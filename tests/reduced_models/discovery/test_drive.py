"""Discovery of terms with the time, and of numbers within terms that may make a pole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.parametric_terms import ParametricTerms, split_parametric_terms
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.terms import parse_term_expressions, split_terms
from reduced_models.discovery.weak_form import estimate_motion, weak_form
from reduced_models.laws.law import HeightLine

TIME = np.linspace(0.0, 40.0, 2000)
FREQUENCY = 1.7
UNPOLISHED = DiscoveryOptions(polish=0)


def driven(seed: int) -> PistonRecord:
    """Motion of z'' = 0.8 sin(1.7 t) - 0.15 z'^3 - 0.3 z z' - z with 1 % of noise."""

    def rates(t: float, state: np.ndarray) -> tuple[float, float]:
        z, v = state
        return v, 0.8 * np.sin(FREQUENCY * t) - 0.15 * v**3 - 0.3 * z * v - z

    z = solve_ivp(rates, (0.0, 40.0), (0.5, 0.0), "DOP853", TIME, rtol=1e-10, atol=1e-12).y[0]
    # A record may begin at any time of its clock: the drive is counted from the first sample.
    noise = np.random.default_rng(seed).normal(0.0, 0.01 * z.std(), len(z))
    return PistonRecord(3.0 + TIME, z + noise)


def texts(found: Discovery) -> dict[str, float]:
    return {term.text.split("(")[0]: value for term, value in (found.best.terms or {}).items()}


def drive_frequency(found: Discovery) -> float:
    return found.model.parameters["w"]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 6))])
def test_a_drive_is_found_with_its_frequency(seed: int) -> None:
    """Nothing is named: neither the library, nor that there is a drive."""
    found = discover(driven(seed), "sindy")
    assert set(texts(found)) == {"z'**3", "z'*z", "z", "sin"}
    assert drive_frequency(found) == pytest.approx(FREQUENCY, rel=1e-3)
    assert texts(found)["sin"] == pytest.approx(0.8, rel=0.01)
    assert any("a drive that no column tells" in note for note in found.notes)


def test_a_drive_may_be_named() -> None:
    terms = ["sin(w*t)", "cos(w*t)"]
    found = discover(driven(0), "sindy", library="polynomial", terms=terms, options=UNPOLISHED)
    assert set(texts(found)) == {"z'**3", "z'*z", "z", "sin"}
    (sine,) = (term for term in found.best.terms or {} if "sin" in term.text)
    assert float(sine.text.removeprefix("sin(").removesuffix("*t)")) == pytest.approx(FREQUENCY, rel=1e-3)


def test_a_free_swing_has_no_drive() -> None:
    """Though no library has its spring, and all leave five times the noise."""
    z = solve_ivp(
        lambda _, state: (state[1], -0.05 * state[1] - np.tanh(6.0 * state[0])),
        (0.0, 40.0),
        (1.5, 0.0),
        "DOP853",
        TIME[::2],
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    noise = np.random.default_rng(0).normal(0.0, 0.01 * z.std(), len(z))
    found = discover(PistonRecord(TIME[::2], z + noise), "sindy", options=UNPOLISHED)
    assert found.best.error > 4.0
    assert not any("drive" in note for note in found.notes)


def test_a_known_time_is_a_term() -> None:
    (term,) = split_terms(parse_term_expressions(["sin(2*t)*z'"])[0]) or ()
    motion = estimate_motion(driven(0), HeightLine())
    assert not term.is_total_derivative
    expected = np.sin(2.0 * motion.time) * motion.velocity
    np.testing.assert_allclose(term.values(motion.smooth_state), expected)


FREE = PistonRecord(
    TIME[:800],
    (np.exp(-0.05 * TIME) * np.cos(1.3 * TIME))[:800] + np.random.default_rng(0).normal(0.0, 0.005, 800),
)


@pytest.mark.parametrize("term", ["1/(z - p)", "z'/(z - p)", "(z - p)**1.5", "sqrt(p)*sin(p*z)"])
def test_a_number_that_makes_a_pole_is_dropped(term: str) -> None:
    """Numbers within the record's range leave less than those outside, and are no terms."""
    motion = estimate_motion(FREE, HeightLine())
    library = split_terms(parse_term_expressions(["z + z'"])[0]) or {}
    _, opened = split_parametric_terms([term], None, ())
    terms = ParametricTerms()
    (found,) = terms.fit_open_terms(opened, weak_form(motion), list(library))
    (number,) = terms.templates_by_term[found][1].values()
    values = found.values(motion.recorded_state)
    assert np.isfinite(values).all()
    assert not motion.z.min() < number < motion.z.max() or "sin" in term
    assert set(texts(discover(FREE, "sindy", library="physical", degree=1, terms=[term], options=UNPOLISHED)))


def test_a_term_without_any_sound_number_is_refused() -> None:
    with pytest.raises(InputError, match="no numbers p make"):
        discover(FREE, "sindy", library="physical", terms=["log(p)*z"], options=UNPOLISHED)
