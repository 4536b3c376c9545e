"""The benchmark of discovery: its systems, the score of laws, and cached cases."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from granular.shared.errors import InputError
from reduced_models.discovery.term_libraries import library_terms
from reduced_models.discovery.terms import state_symbols
from reduced_models.laws.law import HeightLine
from research.campaign import read_results
from research.discovery import runner
from research.discovery.__main__ import CAMPAIGN
from research.discovery.cases import NOISES, OURS, SEEDS, SINDY, Case, all_cases, measured
from research.discovery.judging import score_law
from research.discovery.results import EMPTY, Results
from research.discovery.runner import discovery
from research.discovery.systems import INPUT, SYSTEMS, law_of, made_record, right_structures, system_named
from research.discovery.text import NOT_RUN, text


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda one: one.name)
def test_the_true_law_is_exact_and_in_its_library(system: Any) -> None:
    found = score_law(law_of(system), system)
    assert found.exact
    assert found.error == 0.0
    column = INPUT if system.driven else None
    library = {term.text for term in library_terms(system.library, (), 3, column)}
    assert right_structures(system)[0] <= library


def test_a_wrong_law_is_not_scored_as_found() -> None:
    z, v, _ = state_symbols()
    system = system_named("hard Duffing")
    linear = score_law(-1.5 * z - sympy.Float(0.1) * v, system)
    assert not linear.exact
    assert not linear.usable
    away = score_law(sympy.Float(1.0) * z**3, system)
    assert away.error is None


def test_a_law_of_the_displacement_is_scored_in_heights() -> None:
    z, v, _ = state_symbols()
    system = system_named("linear")
    moved = -1.1 * (z + sympy.Float(0.5)) - 0.1 * v
    found = score_law(moved, system, HeightLine(1.0, 2.0))  # z = (height - 1)/2
    assert found.error == pytest.approx(0.0, abs=1e-6)
    assert not found.exact


def test_noise_has_the_stated_size_and_is_reproducible() -> None:
    system = system_named("pendulum")
    clean, noisy = made_record(system, 0.0, 0), made_record(system, 0.03, 1)
    fraction = float((noisy.height - clean.height).std() / clean.height.std())
    assert fraction == pytest.approx(0.03, rel=0.1)
    np.testing.assert_array_equal(noisy.height, made_record(system, 0.03, 1).height)


def test_cases_with_one_per_cent_of_noise_come_first() -> None:
    cases = all_cases()
    assert len({case.key for case in cases}) == len(cases)
    first = len(cases) // len(NOISES)
    assert {case.noise for case in cases[:first]} == {0.01}
    assert {case.seed for case in cases[:first]} == set(range(SEEDS))


def test_a_peer_finds_a_linear_law() -> None:
    row = measured(Case(SINDY, "linear", "named", 0.001, 0))
    assert row["usable"]
    assert "crash" not in row


def test_an_unexpected_error_is_counted_as_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: object) -> None:
        raise ZeroDivisionError("once")

    monkeypatch.setattr("research.discovery.cases._law", breaks)
    row = measured(Case(OURS, "linear", "named", 0.01, 0))
    assert row["crash"] == "ZeroDivisionError: once"
    found = Results({Case(OURS, "linear", "named", 0.01, 0): row}, {})
    assert found.rate(OURS, "named", 0.01).crashes == 1
    assert "Crashes of `discover`: 1 in 1 runs" in text(found)


def test_an_interrupted_run_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run: list[Case] = []

    def one(case: Case) -> dict[str, Any]:
        if len(run) == 3 and not (tmp_path / "results.json").exists():
            raise KeyboardInterrupt
        run.append(case)
        plain = case._asdict() | {"exact": True, "usable": True, "error": 0.01}
        return plain | {"seconds": 1.0, "equation": "z'' = -z"}

    monkeypatch.setattr(runner, "measured", one)
    with pytest.raises(KeyboardInterrupt):
        discovery(tmp_path, quick=True, progress=False)
    assert len(read_results(tmp_path / "results.json", Results.from_plain, EMPTY).rows) == 3
    found = discovery(tmp_path, quick=True, progress=False)
    assert len(found.rows) == len(set(run)) == len(run) == len(all_cases(runner._QUICK, (0.01,), 1))
    assert NOT_RUN in text(found)
    assert json.loads((tmp_path / "results.json").read_text())["rows"]


def test_an_unknown_system_is_refused() -> None:
    with pytest.raises(InputError, match="unknown system 'nope'; the systems are 'linear'"):
        discovery(systems=["nope"], progress=False)


def test_the_guide_shows_the_committed_results() -> None:
    found = CAMPAIGN.committed()
    assert CAMPAIGN.different(found) == []
    assert CAMPAIGN.different(EMPTY) == ["docs/results/discovery.md: rates"]
