"""Discovery of equations: every method finds the true terms in noisy records; results and errors."""

import functools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from granular.shared import progress_bars
from granular.shared.errors import InputError, RecordError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.discover import Method
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.subset_selection import all_index_subsets, score_subsets_and_make_scorer
from reduced_models.discovery.terms import (
    Term,
    linear_combination,
    physical_library_terms,
    state_symbols,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import SmoothedMotion, make_weak_form
from tests.reduced_models.made import damped_cosine, moved, noisy

TIME = np.linspace(0.0, 40.0, 2000)
UNPOLISHED = DiscoveryOptions(polish=0)
VELOCITY = {"speed": 1, "odd": True}
# Each law: its z'', z(0), and its terms.
LAWS: dict[str, tuple[Callable[..., float], float, dict[Term, float]]] = {
    "van-der-pol-like": (
        lambda t, z, v: -1.0 - 1.05**2 * z + 0.68 * z * v - 0.34 * z**2 * v,
        1.0,
        {Term(0): -1.0, Term(1): -(1.05**2), Term(1, **VELOCITY): 0.68, Term(2, **VELOCITY): -0.34},
    ),
    "duffing": (
        lambda t, z, v: -z - 0.5 * z**3 - 0.1 * v,
        1.5,
        {Term(1): -1.0, Term(3): -0.5, Term(0, **VELOCITY): -0.1},
    ),
    "van-der-pol": (
        lambda t, z, v: -1.1 * z + 0.5 * v - 2.0 * z**2 * v,
        0.3,
        {Term(1): -1.1, Term(0, **VELOCITY): 0.5, Term(2, **VELOCITY): -2.0},
    ),
    "quadratic-drag": (
        lambda t, z, v: -1.2 * z - 0.2 * abs(v) * v,
        1.5,
        {Term(1): -1.2, Term(0, 2, True): -0.2},
    ),
}


@functools.cache
def clean(name: str) -> np.ndarray:
    return moved(LAWS[name][0], TIME, LAWS[name][1])


def made(name: str, seed: int) -> PistonRecord:
    return noisy(TIME, clean(name), 0.01 * clean(name).std(), seed)


@functools.cache
def discovered(name: str) -> Discovery:
    """Return the sparse regression of the first record of a law."""
    return discover(made(name, 0), "sindy", options=UNPOLISHED)


def is_exact(found: Discovery, name: str) -> bool:
    return set(found.best.terms or ()) == set(LAWS[name][2])


def coefficient_errors(found: Discovery, name: str) -> np.ndarray:
    return np.array([(found.best.terms or {})[term] / value - 1.0 for term, value in LAWS[name][2].items()])


@pytest.mark.parametrize(
    # The quick van-der-pol has the same kinds of terms.
    "name",
    [pytest.param(one, marks=pytest.mark.long if one == "van-der-pol-like" else ()) for one in LAWS],
)
def test_sparse_regression_finds_the_true_terms(name: str) -> None:
    found = discovered(name)
    assert is_exact(found, name)
    assert found.best.error == pytest.approx(1.0, abs=0.3)
    assert np.abs(coefficient_errors(found, name)).max() < 0.04


@pytest.mark.parametrize("name", ["quadratic-drag", pytest.param("van-der-pol-like", marks=pytest.mark.long)])
def test_symbolic_regression_finds_the_true_terms(name: str) -> None:
    found = discover(made(name, 0), "operon", options=DiscoveryOptions(polish=0, effort=0.2))
    assert is_exact(found, name)


@pytest.mark.parametrize("method", ["sindy", "operon"])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.long
def test_discovery_finds_the_true_terms_for_at_least_eight_of_ten_noise_seeds(
    method: Method, name: str
) -> None:
    found = [discover(made(name, seed), method) for seed in range(10)]
    exact = [one for one in found if is_exact(one, name)]
    assert len(exact) >= (9 if method == "sindy" else 8)
    errors = np.abs([coefficient_errors(one, name) for one in exact])
    assert np.median(errors, axis=0).max() < 0.01


@pytest.fixture(scope="module")
def coarse_duffing() -> PistonRecord:
    integer = made("duffing", 1)
    return PistonRecord(integer.time[::3], integer.height[::3])


def test_pysindy_finds_the_true_terms_on_smoothed_derivatives(coarse_duffing: PistonRecord) -> None:
    assert is_exact(discover(coarse_duffing, "pysindy", options=UNPOLISHED), "duffing")


def pair() -> list[PistonRecord]:
    """Return a record with small and one with large amplitude for the same spring, of different
    duration and times.
    """
    records = []
    for seed, start in enumerate((0.1, 1.8)):
        z = moved(LAWS["duffing"][0], TIME[:1000], start)
        records.append(noisy(5.0 * seed + TIME[:1000], z, 0.01 * z.std(), seed))
    return records


@pytest.mark.parametrize(
    "method",
    ["sindy", *(pytest.param(name, marks=pytest.mark.long) for name in ("pysindy", "operon"))],  # quick: one
)
def test_discovery_from_several_records_gives_one_common_equation(method: Method) -> None:
    """Only the record with the large amplitude shows that the spring stiffens."""
    found = discover(pair(), method, options=UNPOLISHED)
    assert is_exact(found, "duffing")
    assert np.abs(coefficient_errors(found, "duffing")).max() < 0.1
    with pytest.raises(InputError, match="record"):
        discover([])
    with pytest.raises(InputError, match="takes one record, but 2 are given"):
        discover(pair(), "operon", target="height")


@pytest.mark.long
def test_discovery_from_several_records_fits_shared_parameters() -> None:
    records = pair()
    found = discover(records, "sindy")
    assert is_exact(found, "duffing")
    assert np.abs(coefficient_errors(found, "duffing")).max() < 0.01
    first, second = found.best.models
    assert first.parameters == second.parameters
    for model, record in zip(found.best.models, records, strict=True):
        assert model.quality.relative == pytest.approx(0.01, rel=0.15)
        assert model.quality.samples == len(record)


def test_discoveries_with_the_same_seed_give_the_same_result() -> None:
    from reduced_models.discovery.symbolic_search import search_expressions_with_operon

    z = clean("duffing")[::5]
    v = np.gradient(z, TIME[::5])
    target = -z - 0.5 * z**3 - 0.1 * v + np.random.default_rng(0).normal(0.0, 0.02, len(z))
    found = [
        search_expressions_with_operon({"z": z, "v": v}, target, 0.02, effort=0.025, seed=seed)
        for seed in (4, 4, 5)
    ]
    assert found[0] == found[1]
    assert found[0] != found[2]


def test_discovery_centres_and_scales_a_height_in_metres() -> None:
    record = PistonRecord(TIME[::4], 0.06 + 0.002 * made("duffing", 0).height[::4])
    found = discover(record, "sindy", options=DiscoveryOptions(polish=1))
    assert found.line.shift == pytest.approx(0.06, abs=2e-4)
    assert found.line.scale == pytest.approx(0.003, rel=0.1)
    assert set(LAWS["duffing"][2]) <= set(found.best.terms or ())
    assert found.model.height_line == pytest.approx(found.line, rel=1e-12)
    given = discover(record, "sindy", options=DiscoveryOptions(height="0.06 + 0.002*z", polish=0))
    assert is_exact(given, "duffing")


def test_discovery_finds_a_term_with_an_input_column() -> None:
    def base(t: Any) -> Any:
        return np.sin(1.7 * t) + 0.5 * np.sin(0.6 * t)

    z = moved(lambda t, z, v: -0.2 * v - 1.3 * z + 0.7 * base(t), TIME, 0.5)
    record = noisy(TIME, z, 0.01 * z.std(), extra={"base": base(TIME)})
    found = discover(record, "sindy", input="base", options=UNPOLISHED)
    drive = Term(0, has_input=True)
    assert set(found.best.terms or ()) == {Term(1), Term(0, **VELOCITY), drive}
    assert found.best.terms[drive] == pytest.approx(0.7, rel=0.01)


def test_whitened_weak_residuals_of_the_true_law_have_unit_variance() -> None:
    """The variance is a mean over 40 records."""
    terms, z, squares = LAWS["van-der-pol-like"][2], clean("van-der-pol-like"), []
    values, v, sigma = np.array(list(terms.values())), np.gradient(z, TIME), 0.01 * z.std()
    for seed in range(40):
        record = made("van-der-pol-like", seed).height
        weak = make_weak_form(SmoothedMotion(TIME, record, z, v, np.gradient(v, TIME), None, sigma, 0.0, 6.0))
        whitening = weak.whitening_matrix(tuple(terms), values)
        left = whitening @ (weak.target - weak.term_integral_matrix(tuple(terms)) @ values)
        squares.append((left**2).mean())
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


def test_without_noise_the_true_terms_minimise_the_information_criterion_over_all_subsets() -> None:
    terms = physical_library_terms(2)
    z = clean("van-der-pol")
    v = np.gradient(z, TIME)
    weak = make_weak_form(SmoothedMotion(TIME, z, z, v, np.gradient(v, TIME), None, 1e-4 * z.std(), 0.0, 6.0))
    ranked, scorer = score_subsets_and_make_scorer(weak, terms, terms, all_index_subsets(len(terms)))
    assert set(ranked[0].terms) == set(LAWS["van-der-pol"][2])
    assert scorer.excess < 1.5


def test_terms_are_distinct_and_survive_conversion_to_sympy_and_back() -> None:
    z, v, u = state_symbols()
    products = {
        v * sympy.sign(v): Term(0, 1),
        sympy.Abs(v) * sympy.sign(v) * z: Term(1, 1, True),
        v**2 * sympy.sign(v): Term(0, 2, True),
        v * sympy.Abs(v): Term(0, 2, True),
        sympy.sign(v) ** 2 * z: Term(1),
        sympy.Abs(v) ** 3: Term(0, 3),
        2 * z * u: Term(1, has_input=True),
    }
    for product, term in products.items():
        assert set(terms_with_coefficients(product) or ()) == {term}
    values = np.linspace(1.0, 3.0, len(physical_library_terms(3)))
    assert terms_with_coefficients(
        linear_combination(physical_library_terms(3), list(values))
    ) == pytest.approx(dict(zip(physical_library_terms(3), values, strict=True)))
    assert {one.text for one in terms_with_coefficients(sympy.sin(z) + v) or ()} == {"sin(z)", "z'"}
    assert terms_with_coefficients(sympy.sin(1.5 * z) + v) is None


def test_the_pareto_front_has_no_dominated_candidate() -> None:
    z = state_symbols()[0]
    sizes = [(3, 2.0), (3, 1.5), (5, 1.6), (7, 1.0), (9, 1.0), (9, float("inf"))]
    front = pareto_front([CandidateEquation(z, *size, criterion=0.0) for size in sizes])
    assert [(one.complexity, one.error) for one in front] == [(3, 1.5), (7, 1.0)]


def test_a_discovery_is_converted_to_plain_data() -> None:
    found = discovered("duffing")
    plain = json.loads(json.dumps(found.to_plain(), allow_nan=False))
    assert plain["candidates"][plain["chosen"]]["equation"] == found.best.text
    assert found.best.text in str(found)
    with pytest.raises(InputError, match="not fitted to the record"):
        _ = found.model


@pytest.mark.long
def test_discovery_notes_if_no_equation_of_the_library_describes_the_record() -> None:
    z = moved(lambda t, z, v: -0.1 * v - 4.0 * np.sin(3.0 * z), TIME, 0.9)
    found = discover(noisy(TIME, z, 1e-4), "sindy", degree=1, options=UNPOLISHED)
    assert any("not among the candidates" in note for note in found.notes)


@pytest.mark.long
def test_symbolic_regression_finds_a_damped_cosine_as_a_formula_for_the_height() -> None:
    """The example is from the paper on formulas z(t) by symbolic regression."""
    height = damped_cosine(TIME, 1.3, 0.12, 1.7)
    record = noisy(TIME, height, 0.005)
    found = discover(record, "operon", target="height")
    values = sympy.lambdify(sympy.Symbol("t", real=True), found.expression)(TIME)
    assert np.std(values - height) < 0.002
    assert found.model.quality.residual == pytest.approx(0.005, rel=0.1)
    assert found.model.cycles == ()
    assert found.best.text.startswith("height = ")
    assert np.std(found.model.simulate_signal(record) - height) < 0.002


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"method": "magic"}, "sindy, pysindy, operon, pysr"),
        ({"target": "speed"}, "acceleration, force, height"),
        ({"degree": 9}, "from 1 to 5"),
        ({"target": "height"}, "symbolic"),
        ({"target": "height", "method": "operon", "library": "own"}, "arguments library, terms, input"),
        ({"input": "wind"}, "wind"),
    ],
)
def test_invalid_arguments_of_discovery_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        discover(made("duffing", 0), **arguments)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"polish": -1}, "integer >= 0"),
        ({"height": "no"}, "linear function of z"),
        ({"height": "0.06 + 0*z"}, "linear function of z"),
        ({"height": "0.06 + scale*z"}, "linear function of z"),
        ({"height": 0.06}, "linear function of z"),
        ({"height": ""}, "linear function of z"),
        ({"height": "0.06 m + z"}, "linear function of z"),
        ({"height": "z; w' = 1"}, "linear function of z"),
        ({"effort": 0.0}, r"effort = 0\.0; give a number above 0"),
        ({"functions": 3}, r"functions = 3; give a string or a list"),
    ],
)
def test_invalid_options_of_discovery_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        DiscoveryOptions(**options)


def test_records_unsuitable_for_discovery_are_refused() -> None:
    for record in (PistonRecord(TIME[:10], np.cos(TIME[:10])), PistonRecord(TIME, np.full(len(TIME), 0.06))):
        with pytest.raises(RecordError):
            discover(record)


def test_progress_line_of_a_discovery_shows_the_current_step(
    coarse_duffing: PistonRecord, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress_bars, "LINES_EVERY", 0.0)  # by default one line per minute in a log
    discover(coarse_duffing, "sindy", degree=1, options=DiscoveryOptions(polish=0, progress=True))
    shown = capsys.readouterr().err
    for words in ("discover: libraries", "sparse sums of terms", "done"):
        assert words in shown
    discover(coarse_duffing, "sindy", degree=1, options=UNPOLISHED)
    assert capsys.readouterr().err == ""
