"""The benchmark of equation discovery: its systems, the scores of laws, and cached cases."""

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
from research.discovery.cases import NOISES, OURS, SEEDS, SINDY, DiscoveryCase, all_cases, run_case
from research.discovery.judging import score_law
from research.discovery.results import EMPTY, DiscoveryResults
from research.discovery.runner import run_discovery_study
from research.discovery.systems import (
    INPUT,
    SYSTEMS,
    acceleration_of_system,
    equivalent_term_sets,
    make_noisy_record,
    system_named,
)
from research.discovery.text import NOT_RUN, tables_and_summary_text


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda one: one.name)
def test_the_true_law_is_scored_as_exact_and_lies_in_its_library(system: Any) -> None:
    found = score_law(acceleration_of_system(system), system)
    assert found.exact
    assert found.error == 0.0
    column = INPUT if system.driven else None
    library = {term.text for term in library_terms(system.library, (), 3, column)}
    assert equivalent_term_sets(system)[0] <= library


def test_a_wrong_law_is_not_scored_as_found() -> None:
    z, v, _ = state_symbols()
    system = system_named("hard Duffing")
    linear = score_law(-1.5 * z - sympy.Float(0.1) * v, system)
    assert not linear.exact
    assert not linear.is_usable
    away = score_law(sympy.Float(1.0) * z**3, system)
    assert away.error is None


def test_a_law_for_the_displacement_is_converted_to_heights_before_it_is_scored() -> None:
    z, v, _ = state_symbols()
    system = system_named("linear")
    moved = -1.1 * (z + sympy.Float(0.5)) - 0.1 * v
    found = score_law(moved, system, HeightLine(1.0, 2.0))  # z = (height - 1)/2
    assert found.error == pytest.approx(0.0, abs=1e-6)
    assert not found.exact


def test_noise_of_a_record_has_the_stated_size_and_is_reproducible() -> None:
    system = system_named("pendulum")
    clean, noisy = make_noisy_record(system, 0.0, 0), make_noisy_record(system, 0.03, 1)
    fraction = float((noisy.height - clean.height).std() / clean.height.std())
    assert fraction == pytest.approx(0.03, rel=0.1)
    np.testing.assert_array_equal(noisy.height, make_noisy_record(system, 0.03, 1).height)


def test_cases_with_one_per_cent_of_noise_are_run_first() -> None:
    cases = all_cases()
    assert len({case.key for case in cases}) == len(cases)
    first = len(cases) // len(NOISES)
    assert {case.noise for case in cases[:first]} == {0.01}
    assert {case.seed for case in cases[:first]} == set(range(SEEDS))


def test_another_program_finds_a_linear_law() -> None:
    row = run_case(DiscoveryCase(SINDY, "linear", "named", 0.001, 0))
    assert row["usable"]
    assert "crash" not in row


def test_an_unexpected_error_in_the_discovery_benchmark_is_counted_as_a_crash(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def breaks(*_: object) -> None:
        raise ZeroDivisionError("once")

    monkeypatch.setattr("research.discovery.cases._law_and_line_by_method", breaks)
    row = run_case(DiscoveryCase(OURS, "linear", "named", 0.01, 0))
    assert row["crash"] == "ZeroDivisionError: once"
    found = DiscoveryResults({DiscoveryCase(OURS, "linear", "named", 0.01, 0): row}, {})
    assert found.rate_of_method(OURS, "named", 0.01).crashes == 1
    assert "Crashes of `discover`: 1 in 1 runs" in tables_and_summary_text(found)


def test_an_interrupted_discovery_benchmark_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run: list[DiscoveryCase] = []

    def one(case: DiscoveryCase) -> dict[str, Any]:
        if len(run) == 3 and not (tmp_path / "results.json").exists():
            raise KeyboardInterrupt
        run.append(case)
        plain = case._asdict() | {"exact": True, "usable": True, "error": 0.01}
        return plain | {"seconds": 1.0, "equation": "z'' = -z"}

    monkeypatch.setattr(runner, "run_case", one)
    with pytest.raises(KeyboardInterrupt):
        run_discovery_study(tmp_path, quick=True, progress=False)
    assert len(read_results(tmp_path / "results.json", DiscoveryResults.from_plain, EMPTY).rows) == 3
    found = run_discovery_study(tmp_path, quick=True, progress=False)
    assert len(found.rows) == len(set(run)) == len(run) == len(all_cases(runner._QUICK, (0.01,), 1))
    assert NOT_RUN in tables_and_summary_text(found)
    assert json.loads((tmp_path / "results.json").read_text())["rows"]


def test_an_unknown_system_is_refused() -> None:
    with pytest.raises(InputError, match="unknown system 'nope'; the systems are 'linear'"):
        run_discovery_study(systems=["nope"], progress=False)


def test_the_guide_shows_the_committed_results_of_the_discovery_benchmark() -> None:
    found = CAMPAIGN.read_committed_results()
    assert CAMPAIGN.outdated_blocks(found) == []
    assert CAMPAIGN.outdated_blocks(EMPTY) == ["docs/results/discovery.md: rates"]
