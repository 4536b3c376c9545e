"""What the benchmark of fits measures is a fit that found the truth."""

from __future__ import annotations

import pytest

from benchmarks.fits import TRUTHS, fits, measured_here
from benchmarks.process import ProcessError


def test_a_measured_fit_is_a_good_one() -> None:
    found = measured_here("linear", 500, 2)
    assert len(found["warm"]) == 2
    assert 0.0 < found["error"] < 0.01
    assert found["converged"] > 0.8


def test_truths_name_all_parameters() -> None:
    from reduced_models.laws import law_named

    for name, truth in TRUTHS.items():
        assert set(truth.parameters) == set(law_named(name).parameters)


def test_a_process_that_fails_says_why() -> None:
    with pytest.raises(ProcessError, match="KeyError"):
        fits("tea-leaves", 500, 0)
