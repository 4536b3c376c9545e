"""Discovery: exact structures from noisy records, by every method, and honest results."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from granular.shared import progress_bars
from granular.shared.errors import InputError, RecordError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.options import Method
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.subset_selection import all_index_subsets, score_subsets
from reduced_models.discovery.terms import (
    Term,
    linear_combination,
    physical_library_terms,
    split_terms,
    state_symbols,
)
from reduced_models.discovery.weak_form import SmoothedMotion, weak_form

TIME = np.linspace(0.0, 40.0, 2000)
UNPOLISHED = DiscoveryOptions(polish=0)
VELOCITY = {"speed": 1, "odd": True}
# Each law: its z'', coefficients, z(0), and its terms in the same order.
LAWS = {
    "van-der-pol-like": (
        lambda c, z, v: c[0] + c[1] * z + c[2] * z * v + c[3] * z**2 * v,
        (-1.0, -(1.05**2), 0.68, -0.34),
        1.0,
        (Term(0), Term(1), Term(1, **VELOCITY), Term(2, **VELOCITY)),
    ),
    "duffing": (
        lambda c, z, v: c[0] * z + c[1] * z**3 + c[2] * v,
        (-1.0, -0.5, -0.1),
        1.5,
        (Term(1), Term(3), Term(0, **VELOCITY)),
    ),
    "van-der-pol": (
        lambda c, z, v: c[0] * z + c[1] * v + c[2] * z**2 * v,
        (-1.1, 0.5, -2.0),
        0.3,
        (Term(1), Term(0, **VELOCITY), Term(2, **VELOCITY)),
    ),
    "quadratic-drag": (
        lambda c, z, v: c[0] * z + c[1] * abs(v) * v,
        (-1.2, -0.2),
        1.5,
        (Term(1), Term(0, 2, True)),
    ),
}


@functools.cache
def clean(name: str) -> np.ndarray:
    return motion(name, TIME, LAWS[name][2])


def motion(name: str, time: np.ndarray, start: float) -> np.ndarray:
    """By a solver of another house, that compiles nothing."""
    from scipy.integrate import solve_ivp

    law, values, _, _ = LAWS[name]
    solved = solve_ivp(
        lambda _, y: [y[1], law(values, *y)],
        (0.0, time[-1]),
        [start, 0.0],
        "DOP853",
        time,
        rtol=1e-10,
        atol=1e-12,
    )
    return np.asarray(solved.y[0])


def made(name: str, seed: int, level: float = 0.01) -> PistonRecord:
    z = clean(name)
    return PistonRecord(TIME, z + np.random.default_rng(seed).normal(0.0, level * z.std(), len(z)))


@functools.cache
def discovered(name: str) -> Discovery:
    """Sparse regression of the first record of a law."""
    return discover(made(name, 0), "sindy", options=UNPOLISHED)


def is_exact(found: Discovery, name: str) -> bool:
    return set(found.best.terms or ()) == set(LAWS[name][3])


def coefficient_errors(found: Discovery, name: str) -> np.ndarray:
    _, values, _, terms = LAWS[name]
    assert found.best.terms is not None
    return np.array([found.best.terms[t] / v - 1.0 for t, v in zip(terms, values, strict=True)])


@pytest.mark.parametrize(
    # The quick van-der-pol has the same kinds of terms.
    "name",
    [pytest.param(one, marks=pytest.mark.long if one == "van-der-pol-like" else ()) for one in LAWS],
)
def test_sparse_regression_finds_the_structure(name: str) -> None:
    found = discovered(name)
    assert is_exact(found, name)
    assert found.best.error == pytest.approx(1.0, abs=0.3)
    assert np.abs(coefficient_errors(found, name)).max() < 0.04


@pytest.mark.parametrize("name", ["quadratic-drag", pytest.param("van-der-pol-like", marks=pytest.mark.long)])
def test_symbolic_regression_finds_the_structure(name: str) -> None:
    found = discover(made(name, 0), "operon", options=DiscoveryOptions(polish=0, effort=0.2))
    assert is_exact(found, name)


@pytest.mark.long
def test_every_candidate_that_matters_is_polished() -> None:
    found = discover(made("van-der-pol-like", 0), "sindy")
    assert is_exact(found, "van-der-pol-like")
    model = found.model
    assert model.quality.relative == pytest.approx(0.01, rel=0.1)
    # The interval of the noisiest coefficient is 2.6 % wide to each side on one record.
    assert np.abs(coefficient_errors(found, "van-der-pol-like")).max() < 0.03
    for value, (low, high) in zip(model.parameters.values(), model.intervals.values(), strict=True):
        assert low <= value <= high
    later = model.simulate(TIME)
    assert np.std(later.height - clean("van-der-pol-like")) < 0.005
    numbers = {float(one) for one in found.best.expression.atoms(sympy.Float)}
    assert numbers == set(model.parameters.values())


@pytest.mark.parametrize("method", ["sindy", "operon"])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.long
def test_ten_seeds(method: Method, name: str) -> None:
    found = [discover(made(name, seed), method) for seed in range(10)]
    exact = [one for one in found if is_exact(one, name)]
    assert len(exact) >= (9 if method == "sindy" else 8)
    errors = np.abs([coefficient_errors(one, name) for one in exact])
    assert np.median(errors, axis=0).max() < 0.01


@pytest.fixture(scope="module")
def coarse_duffing() -> PistonRecord:
    integer = made("duffing", 1)
    return PistonRecord(integer.time[::3], integer.height[::3])


def test_pysindy_finds_the_structure_on_smoothed_derivatives(coarse_duffing: PistonRecord) -> None:
    assert is_exact(discover(coarse_duffing, "pysindy", options=UNPOLISHED), "duffing")


def pair(name: str, starts: tuple[float, float]) -> list[PistonRecord]:
    """Two records of half the usual length, from other heights and at other times."""
    time, records = TIME[:1000], []
    for seed, start in enumerate(starts):
        z = motion(name, time, start)
        noise = np.random.default_rng(seed).normal(0.0, 0.01 * z.std(), len(z))
        records.append(PistonRecord(5.0 * seed + time, z + noise))
    return records


@pytest.mark.parametrize(
    "method",
    [
        "sindy",
        pytest.param("pysindy", marks=pytest.mark.long),  # quick: one record
        pytest.param("operon", marks=pytest.mark.long),
    ],
)
def test_several_records_have_one_structure(method: Method) -> None:
    """A small and a large swing of the same spring, which stiffens in the large one alone."""
    found = discover(pair("duffing", (0.1, 1.8)), method, options=UNPOLISHED)
    assert is_exact(found, "duffing")
    assert np.abs(coefficient_errors(found, "duffing")).max() < 0.1


@pytest.mark.long  # quick: with the large one, above
def test_the_small_swing_alone_hides_the_spring() -> None:
    found = discover(pair("duffing", (0.1, 1.8))[0], "sindy", options=UNPOLISHED)
    assert set(found.best.terms or ()) == {Term(1), Term(0, **VELOCITY)}


@pytest.mark.long
def test_several_records_share_the_polished_numbers() -> None:
    records = pair("duffing", (0.1, 1.8))
    found = discover(records, "sindy")
    assert is_exact(found, "duffing")
    assert np.abs(coefficient_errors(found, "duffing")).max() < 0.01
    first, second = found.best.models
    assert first.parameters == second.parameters
    for model, record in zip(found.best.models, records, strict=True):
        assert model.quality.relative == pytest.approx(0.01, rel=0.15)
        assert model.quality.samples == len(record)
    with pytest.raises(InputError, match="no record"):
        discover([])
    with pytest.raises(InputError, match="of one record, not of 2"):
        discover(records, "operon", target="height")


@pytest.mark.long  # quick: several records in Python, and the commands as they are shown
def test_the_command_takes_several_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from reduced_models.__main__ import main

    names = []
    for k, record in enumerate(pair("duffing", (0.1, 1.8))):
        names.append(str(tmp_path / f"{k}.csv"))
        record.to_csv(names[-1])
    main(["discover", *names, "--method", "sindy", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["model"]["quality"]["samples"] == 1000
    assert len(found["model"]["parameters"]) == 3


@pytest.mark.long
def test_terms_that_may_be_zero_are_left_out() -> None:
    """Record 5 calls for a friction of nothing in the weak form; its fit shows that it is none."""
    record = made("quadratic-drag", 5)
    assert not is_exact(discover(record, "sindy", options=UNPOLISHED), "quadratic-drag")
    found = discover(record, "sindy", options=DiscoveryOptions(polish=1))
    assert is_exact(found, "quadratic-drag")
    assert np.abs(coefficient_errors(found, "quadratic-drag")).max() < 0.01
    assert found.notes == ()


def test_a_seed_repeats_a_search() -> None:
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


@pytest.mark.long  # quick: records with noise
def test_noise_free_records_keep_their_structure() -> None:
    for name in LAWS:
        found = discover(made(name, 0, level=0.0), "sindy", options=UNPOLISHED)
        assert is_exact(found, name)
        assert np.abs(coefficient_errors(found, name)).max() < 1e-3


def test_a_height_in_metres_is_centred_and_scaled() -> None:
    record = PistonRecord(TIME[::4], 0.06 + 0.002 * made("duffing", 0).height[::4])
    found = discover(record, "sindy", options=DiscoveryOptions(polish=1))
    assert found.line.shift == pytest.approx(0.06, abs=2e-4)
    assert found.line.scale == pytest.approx(0.003, rel=0.1)
    assert set(LAWS["duffing"][3]) <= set(found.best.terms or ())
    assert found.model.height_line == pytest.approx(found.line, rel=1e-12)
    given = discover(record, "sindy", options=DiscoveryOptions(height="0.06 + 0.002*z", polish=0))
    assert is_exact(given, "duffing")


def test_an_input_is_a_term() -> None:
    from scipy.integrate import solve_ivp

    def base(t: np.ndarray) -> np.ndarray:
        return np.sin(1.7 * t) + 0.5 * np.sin(0.6 * t)

    solved = solve_ivp(
        lambda t, y: [y[1], -0.2 * y[1] - 1.3 * y[0] + 0.7 * base(t)],
        (0.0, 40.0),
        [0.5, 0.0],
        "DOP853",
        TIME,
        rtol=1e-10,
    )
    z = solved.y[0] + np.random.default_rng(0).normal(0.0, 0.01 * solved.y[0].std(), len(TIME))
    record = PistonRecord(TIME, z, extra={"base": base(TIME)})
    found = discover(record, "sindy", input="base", options=UNPOLISHED)
    drive = Term(0, has_input=True)
    assert set(found.best.terms or ()) == {Term(1), Term(0, **VELOCITY), drive}
    assert found.best.terms[drive] == pytest.approx(0.7, rel=0.01)


def test_noise_shares_the_weak_residuals_out_as_predicted() -> None:
    """With the true law, the white residuals have unit variance, over 40 records."""
    _, values, _, terms = LAWS["van-der-pol-like"]
    z, squares = clean("van-der-pol-like"), []
    sigma = 0.01 * z.std()
    v = np.gradient(z, TIME)
    for seed in range(40):
        record = made("van-der-pol-like", seed).height
        weak = weak_form(SmoothedMotion(TIME, record, z, v, np.gradient(v, TIME), None, sigma, 0.0, 6.0))
        whitening = weak.whitening_matrix(terms, np.array(values))
        left = whitening @ (weak.target - weak.term_integral_matrix(terms) @ np.array(values))
        squares.append((left**2).mean())
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


def test_the_criterion_of_all_subsets_is_least_for_the_truth_without_noise() -> None:
    terms = physical_library_terms(2)
    z = clean("van-der-pol")
    v = np.gradient(z, TIME)
    weak = weak_form(SmoothedMotion(TIME, z, z, v, np.gradient(v, TIME), None, 1e-4 * z.std(), 0.0, 6.0))
    ranked, scorer = score_subsets(weak, terms, terms, all_index_subsets(len(terms)))
    assert set(ranked[0].terms) == set(LAWS["van-der-pol"][3])
    assert scorer.excess < 1.5


def test_terms_are_unique_and_go_there_and_back() -> None:
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
        assert set(split_terms(product) or ()) == {term}
    values = np.linspace(1.0, 3.0, len(physical_library_terms(3)))
    assert split_terms(linear_combination(physical_library_terms(3), list(values))) == pytest.approx(
        dict(zip(physical_library_terms(3), values, strict=True))
    )
    assert {one.text for one in split_terms(sympy.sin(z) + v) or ()} == {"sin(z)", "z'"}
    assert split_terms(sympy.sin(1.5 * z) + v) is None


def test_the_pareto_front_holds_no_dominated_candidate() -> None:
    z = state_symbols()[0]
    sizes = [(3, 2.0), (3, 1.5), (5, 1.6), (7, 1.0), (9, 1.0), (9, float("inf"))]
    front = pareto_front([CandidateEquation(z, *size, criterion=0.0) for size in sizes])
    assert [(one.complexity, one.error) for one in front] == [(3, 1.5), (7, 1.0)]


def test_a_discovery_is_plain_data() -> None:
    found = discovered("duffing")
    plain = json.loads(json.dumps(found.to_plain(), allow_nan=False))
    assert plain["candidates"][plain["chosen"]]["equation"] == found.best.text
    assert found.best.text in str(found)
    with pytest.raises(InputError, match="not polished"):
        _ = found.model


@pytest.mark.long
def test_a_law_outside_the_library_is_noted() -> None:
    from scipy.integrate import solve_ivp

    solved = solve_ivp(
        lambda _, y: [y[1], -0.1 * y[1] - 4.0 * np.sin(3.0 * y[0])],
        (0.0, 40.0),
        [0.9, 0.0],
        "DOP853",
        TIME,
        rtol=1e-10,
    )
    noise = np.random.default_rng(0).normal(0.0, 1e-4, len(TIME))
    found = discover(PistonRecord(TIME, solved.y[0] + noise), "sindy", degree=1, options=UNPOLISHED)
    assert any("not among those searched" in note for note in found.notes)


@pytest.mark.long
def test_symbolic_regression_finds_a_damped_cosine() -> None:
    """The source's demonstration, z(t) itself."""
    height = 1.3 * np.exp(-0.12 * TIME) * np.cos(1.7 * TIME)
    noise = np.random.default_rng(0).normal(0.0, 0.005, len(TIME))
    record = PistonRecord(TIME, height + noise)
    found = discover(record, "operon", target="height")
    t = sympy.Symbol("t", real=True)
    values = sympy.lambdify(t, found.expression)(TIME)
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
        ({"target": "height", "method": "operon", "library": "own"}, "leave out library, terms, input"),
        ({"input": "wind"}, "wind"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        discover(made("duffing", 0), **arguments)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"polish": -1}, "from 0 on"),
        ({"height": "no"}, "straight line in z"),
        ({"height": "0.06 + 0*z"}, "straight line in z"),
        ({"height": "0.06 + scale*z"}, "straight line in z"),
        ({"height": 0.06}, "straight line in z"),
        ({"height": ""}, "straight line in z"),
        ({"height": "0.06 m + z"}, "straight line in z"),
        ({"height": "z; w' = 1"}, "straight line in z"),
        ({"effort": 0.0}, r"effort = 0\.0; give a number above 0"),
        ({"functions": 3}, r"functions = 3; give a text, or several"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        DiscoveryOptions(**options)


def test_bad_records_are_refused() -> None:
    for record in (PistonRecord(TIME[:10], np.cos(TIME[:10])), PistonRecord(TIME, np.full(len(TIME), 0.06))):
        with pytest.raises(RecordError):
            discover(record)


def test_a_line_shows_what_is_done(
    coarse_duffing: PistonRecord, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress_bars, "LINES_EVERY", 0.0)  # a log has a line a minute
    discover(coarse_duffing, "sindy", degree=1, options=DiscoveryOptions(polish=0, progress=True))
    shown = capsys.readouterr().err
    for words in ("discover: libraries", "sparse sums of terms", "done"):
        assert words in shown
    discover(coarse_duffing, "sindy", degree=1, options=UNPOLISHED)
    assert capsys.readouterr().err == ""
