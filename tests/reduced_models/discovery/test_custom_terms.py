"""Discovery of equations with custom terms, named libraries, and functions other than powers of z and z'."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover, fit
from reduced_models.discovery.candidate_choice import (
    compose_law_name_from_terms,
    fit_candidates_and_choose_index,
)
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.structure_proposals import ProposedStructures, WeakFormStudy
from reduced_models.discovery.subset_selection import score_subsets_and_make_scorer
from reduced_models.discovery.term_libraries import LIBRARIES, library_terms
from reduced_models.discovery.terms import (
    CustomTerm,
    TermArguments,
    linear_combination,
    parse_term_expressions,
    physical_library_terms,
    state_symbols,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import SmoothedMotion, make_weak_form
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import moved, noise, noisy

TIME = np.linspace(0.0, 40.0, 2000)
UNPOLISHED = DiscoveryOptions(polish=0)
FORCE = np.sin(0.9 * TIME) + 0.5 * np.sin(2.3 * TIME + 1.0)


def push(t: float) -> float:
    return float(np.interp(t, TIME, FORCE))


# Each: z''(t, z, v), z(0), options, and its terms.
SYSTEMS = {
    "pendulum": (
        lambda t, z, v: -0.3 * v - 2.0 * np.sin(z),
        2.5,
        {"library": "trigonometric"},
        {"sin(z)", "z'"},
    ),
    "quintic spring": (
        lambda t, z, v: -0.1 * v - z - 0.5 * z**5,
        1.3,
        {"library": "polynomial"},
        {"z", "z**5", "z'"},
    ),
    "cubic drag": (lambda t, z, v: -z - 0.1 * v**3, 1.5, {"terms": ["z'**3"]}, {"z", "z'**3"}),
    "driven spring": (
        lambda t, z, v: -0.2 * v - z - 0.5 * z**3 + 0.7 * push(t) * z,
        1.0,
        {"library": "driven", "input": "push"},
        {"z", "z**3", "z'", "u*z"},
    ),
}


def motion(name: str) -> np.ndarray:
    law, start, *_ = SYSTEMS[name]
    return moved(law, TIME, start, rtol=1e-9, atol=1e-11, max_step=0.05)


def discovered_terms(name: str, seed: int) -> set[str]:
    z, options = motion(name), SYSTEMS[name][2]
    record = noisy(TIME, z, 0.01 * z.std(), seed, extra={"push": FORCE})
    found = discover(record, "sindy", options=UNPOLISHED, **options)  # type: ignore[arg-type]  # by name
    return {term.text for term in found.best.terms or ()}


@pytest.mark.parametrize(
    "name",
    # an input as a separate term has a quick test in `test_discovery`
    [pytest.param(one, marks=pytest.mark.long if one == "driven spring" else ()) for one in SYSTEMS],
)
def test_discovery_finds_the_true_terms_with_the_right_library(name: str) -> None:
    assert discovered_terms(name, 0) == SYSTEMS[name][3]


@pytest.mark.long
@pytest.mark.parametrize("name", SYSTEMS)
def test_discovery_finds_the_true_terms_for_four_of_five_noise_seeds(name: str) -> None:
    found = sum(discovered_terms(name, seed) == SYSTEMS[name][3] for seed in range(5))
    print(f"\n{name}: {found} of 5")
    assert found >= 4


@pytest.mark.long
@pytest.mark.parametrize("name", SYSTEMS)
def test_symbolic_regression_finds_powers_that_the_library_lacks(name: str) -> None:
    """A sine is approximated by its power series."""
    z, (_, _, options, right), exact = motion(name), SYSTEMS[name], 0
    for seed in range(5):
        record = noisy(TIME, z, 0.01 * z.std(), seed, extra={"push": FORCE})
        drive = options.get("input")
        found = discover(record, "operon", library="physical", input=drive, seed=seed, options=UNPOLISHED)
        print(name, seed, f"{found.best.error:.2f}", found.best.text)
        assert found.best.error < 1.5
        exact += {term.text for term in found.best.terms or ()} == right
    assert exact >= (0 if name == "pendulum" else 4)


@pytest.mark.long
def test_discovery_by_the_method_auto_also_tries_symbolic_regression() -> None:
    """Cubic drag is not in the physical library, so that only symbolic regression proposes it."""
    z = motion("cubic drag")
    found = discover(noisy(TIME, z, 0.001 * z.std()), options=UNPOLISHED)
    assert found.method == "sindy and operon"
    assert {term.text for term in found.best.terms or ()} == SYSTEMS["cubic drag"][3]


@pytest.mark.parametrize("column", [None, "force"])
@pytest.mark.parametrize("name", sorted(set(LIBRARIES) - {"physical", "driven"}))
def test_library_terms_survive_conversion_to_sympy_and_back(name: str, column: str | None) -> None:
    terms = library_terms(name, (), 3, column)
    with_input = [term for term in terms if "u" in map(str, linear_combination([term], [1.0]).free_symbols)]
    assert len(set(terms)) == len(terms) == len(LIBRARIES[name][0]) + len(with_input)
    assert bool(with_input) == (column is not None)
    values = np.linspace(1.0, 2.0, len(terms))
    assert terms_with_coefficients(linear_combination(terms, list(values))) == pytest.approx(
        dict(zip(terms, values, strict=True))
    )


CUSTOM = ("sin(z)", "cos(2*z)*z'", "max(0, z)**1.5", "exp(-z)*abs(z')", "z'/z", "u*sin(z)", "tanh(z')")


@given(st.sampled_from(CUSTOM), st.floats(0.3, 2.0), st.floats(0.2, 2.0), st.floats(-2.0, 2.0))
def test_derivatives_of_custom_terms_agree_with_finite_differences(
    text: str, z: float, v: float, u: float
) -> None:
    (term,) = terms_with_coefficients(parse_term_expressions([text], "u")[0]) or ()
    assert isinstance(term, CustomTerm)
    h = 1e-6

    def at(dz: float, dv: float) -> float:
        return float(term.values(TermArguments(np.array([z + dz]), np.array([v + dv]), np.array([u])))[0])

    here = TermArguments(np.array([z]), np.array([v]), np.array([u]))
    by_height, by_speed = term.derivative_by_height(here), term.derivative_by_speed(here)
    assert float(by_height[0]) == pytest.approx((at(h, 0) - at(-h, 0)) / (2 * h), abs=1e-6)
    assert float(by_speed[0]) == pytest.approx((at(0, h) - at(0, -h)) / (2 * h), abs=1e-6)
    if term.is_total_derivative:
        low, high = term.antiderivative(np.array([z - h, z + h]))
        assert (high - low) / (2 * h) * v == pytest.approx(at(0, 0), abs=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "z'*exp(-z**2)",
        "z'*sin(z**2)",
        "z'*sqrt(1+z**4)",
        "z'/(z-3)",
        "z'*sin(z)**2*exp(-z**2)",
        "z'*exp(sin(z)*cos(z)**2)/(3+z**3)",
        "max(0, z)*z'",
    ],
)
def test_weak_form_of_a_damping_term_needs_no_closed_antiderivative(text: str) -> None:
    """Integrals of G'(z) z' with the test functions follow from numerical values of G."""
    z, v = np.cos(TIME), -np.sin(TIME)
    (term,) = terms_with_coefficients(parse_term_expressions([text])[0]) or ()
    assert term.is_total_derivative
    (part,) = make_weak_form(SmoothedMotion(TIME, z, z, v, -z, None, 1e-3, 0.0, 6.0)).parts
    direct = part.bump @ term.values(TermArguments(z, v))
    assert part.term_integrals(term) == pytest.approx(direct, abs=1e-4 * float(np.abs(direct).max()))


def test_discovery_finds_damping_divided_by_the_height_also_at_negative_heights() -> None:
    z = moved(lambda t, z, v: -(z + 3.0) + 0.4 * v / z, TIME, -2.0)
    found = discover(PistonRecord(TIME, z), "sindy", library=(), terms=["1", "z", "z'/z"], options=UNPOLISHED)
    values = {term.text: value for term, value in (found.best.terms or {}).items()}
    assert values == pytest.approx({"1": -3.0, "z": -1.0, "z'/z": 0.4}, rel=1e-3)


def test_whitened_residuals_with_a_custom_term_have_unit_variance() -> None:
    """The residuals are computed with the true equation."""
    z = motion("pendulum")
    v, level = np.gradient(z, TIME), 0.01 * float(z.std())
    terms = tuple(terms_with_coefficients(parse_term_expressions(["sin(z) + z'"])[0]) or ())
    misfits = []
    for seed in range(5):
        shown = z + noise(len(z), level, seed)
        weak = make_weak_form(SmoothedMotion(TIME, shown, z, v, np.gradient(v, TIME), None, level, 0.0, 6.0))
        misfits.append(score_subsets_and_make_scorer(weak, terms, terms, [np.array([[0, 1]])])[0][0].misfit)
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.1)


def test_discovery_finds_the_value_of_a_parameter_inside_a_term() -> None:
    """The record is a decay with 1 % noise, whose spring is stiffer beyond 4 mm."""
    time = np.linspace(0.0, 8.0, 700)
    decay = moved(
        lambda t, z, v: -0.3 * v - 30.0 * z - 400.0 * max(0.0, z - 0.004), time, 0.012, max_step=0.01
    )
    record = noisy(time, decay, 0.01 * decay.std())
    options: dict[str, Any] = {"library": "physical", "degree": 1, "terms": ["max(0, z - d)"]}
    found = discover(record, "sindy", options=UNPOLISHED, **options)
    assert len(found.best.terms or {}) == 3
    gap = re.search(r"max\(0, z - ([0-9.]+)\)", found.best.text)
    assert float(gap[1]) == pytest.approx(0.004, rel=0.03)
    with pytest.raises(InputError, match="looks like a column"):
        discover(record, "sindy", terms=["max(0, z - force)"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"terms": ["sin(w)"]}, r"contains w; terms are functions of z, z', t and"),
        ({"terms": ["sin(z"]}, r"cannot be read"),
        ({"terms": ["z - z"]}, r"is zero; remove it"),
        ({"terms": ["__import__('os')"]}, r"cannot be read"),
        ({"terms": ["log(z)"]}, r"the term 'log\(z\)' is not finite for z from"),
        ({"terms": ["z'/z"]}, r"the term \"z'/z\" has a pole for z from"),
        ({"terms": ["z**-2"]}, r"the term 'z\*\*\(-2\)' has a pole for z from"),
        ({"terms": ["sqrt(max(0, z))"]}, r"has no finite slope for z from"),
        ({"terms": "sin(w)"}, r"the term 'sin\(w\)' contains w"),
        ({"library": None}, r"library = None; give a string or a list"),
        ({"library": 3}, r"library = 3; give a string or a list"),
        ({"seed": -1}, r"seed = -1; give an integer from 0"),
        ({"method": "operon", "seed": -3}, r"seed = -3; give an integer from 0"),
        ({"terms": [3]}, r"terms = \[3\]; give a string or a list"),
        ({"library": "cubic"}, r"library = 'cubic'; give one or more of physical"),
        ({"library": "driven"}, r"needs an input"),
        ({"library": ()}, r"no terms to choose from"),
    ],
)
def test_invalid_custom_terms_are_refused(options: dict[str, object], words: str) -> None:
    record = PistonRecord(TIME, np.round(np.cos(TIME), 2))
    with pytest.raises(InputError, match=words):
        discover(record, **{"method": "sindy", "library": "physical", **options})  # type: ignore[arg-type]  # by name


@pytest.mark.parametrize(
    ("method", "functions", "words"),
    [
        ("sindy", "sin", r"argument functions is only for symbolic regression"),
        ("operon", "gamma", r"the function 'gamma' is unknown"),
        ("operon", ["gamma"], r"the function 'gamma' is unknown"),
    ],
)
def test_unknown_functions_in_a_library_are_refused(method: Any, functions: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        discover(PistonRecord(TIME, np.cos(TIME)), method, options=DiscoveryOptions(functions=functions))


def test_functions_for_symbolic_regression_give_an_error_if_pyoperon_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("reduced_models.discovery.discover.is_operon_installed", lambda: False)
    record = PistonRecord(TIME, np.cos(TIME))
    with pytest.raises(InputError, match="functions need symbolic regression"):
        discover(record, options=DiscoveryOptions(functions=["sin"]))
    found = discover(record, library=(), terms=["z", "z'"], options=UNPOLISHED)
    assert any("pyoperon is not installed" in note for note in found.notes)


def test_the_terms_of_the_contact_library_are_linearly_independent() -> None:
    z, v = (each.ravel() for each in np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-2, 2, 20)))
    terms = library_terms("contact", (), 3, None)
    columns = np.stack([term.values(TermArguments(z, v)) for term in terms], axis=1)
    assert np.linalg.matrix_rank(columns) == len(terms)


def test_maxima_with_permuted_or_repeated_operands_count_as_the_same_term() -> None:
    texts = ["max(0, z)", "max(z, 0)", "max(z, 0, z)", "max(0, max(0, z))"]
    assert len(library_terms((), texts, 3, None)) == 1


def test_an_equation_is_split_into_its_terms() -> None:
    texts = [term.text for term in library_terms((), ["sin(z) + 0.1*z**3"], 3, None)]
    assert texts == ["z**3", "sin(z)"]


def test_z_is_the_height_itself_in_libraries_whose_functions_have_a_fixed_origin() -> None:
    """In the physical library, z is the displacement from equilibrium."""
    record = PistonRecord(TIME, 2.0 + 0.1 * np.cos(TIME))
    assert discover(record, "sindy", options=UNPOLISHED).line != HeightLine()
    assert discover(record, "sindy", library="rational", options=UNPOLISHED).line == HeightLine()


def test_the_chosen_equation_has_a_fitted_model_if_any_candidate_has_one() -> None:
    """Here the best candidates cannot be fitted to the motion, but a later one can."""
    z, v, _ = state_symbols()
    wave, slope = np.cos(TIME), -np.sin(TIME)
    motion = SmoothedMotion(TIME, wave, wave, slope, -wave, None, 1e-3, 0.0, 6.0)
    weak, library = make_weak_form(motion), physical_library_terms(1)
    _, scorer = score_subsets_and_make_scorer(weak, library, library, [np.array([[0]])])
    model = fit(PistonRecord(TIME, wave), "linear", starts=2, test_fraction=0.0)
    wavy = sympy.sin(1.5 * z)  # not a sum of terms, so it cannot be pruned
    candidates = [CandidateEquation(wavy**k + v, 5 + k, 9.0 - k, 10.0 * k) for k in range(1, 8)]

    def polish(one: CandidateEquation) -> CandidateEquation:
        return dataclasses.replace(one, models=(model,)) if one is candidates[4] else one

    proposed = ProposedStructures(candidates, scorer, WeakFormStudy(weak, library))
    front, chosen = fit_candidates_and_choose_index(proposed, polish, 2)
    assert front[chosen].model is model
    front, chosen = fit_candidates_and_choose_index(proposed, polish, 0)
    assert front[chosen] is candidates[0]


@pytest.mark.parametrize(
    ("equation", "words"),
    [
        ("-0.1*v - 2.0*z + 3.0", "viscous + linear spring"),
        ("-0.1*v - 0.2*sign(v) - 2.0*z + 0.3*z**3", "viscous + dry friction + softening"),
        ("-0.1*Abs(v)*v - 2.0*z - 0.3*z**3", "quadratic drag + hardening"),
        ("0.2*v - 0.2*z**2*v - z", "negative viscous + viscous by z**2 + linear spring"),
        ("-0.1*v + z - z**3", "viscous + two wells"),
        ("-0.1*v - z + 0.2*z**2", "viscous + asymmetric spring"),
        ("-0.1*v - 2.0*sin(z) + 0.7*u", "viscous + u + sin(z)"),
    ],
)
def test_a_discovered_law_is_named_after_its_terms(equation: str, words: str) -> None:
    z, v, u = state_symbols()
    names = {"z": z, "v": v, "u": u, "sign": sympy.sign, "Abs": sympy.Abs, "sin": sympy.sin}
    expression = sympy.sympify(equation, locals=names)
    candidate = CandidateEquation(expression, 1, 1.0, 1.0)
    assert compose_law_name_from_terms(candidate) == words
