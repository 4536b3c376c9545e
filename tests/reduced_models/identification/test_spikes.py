"""Single samples far off the best law: left out and noted, kept on request, and kept where time is short."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

import numpy as np
import pytest

from granular.shared.errors import InputError, RecordWarning
from reduced_models import PistonRecord, identify
from reduced_models.identification.comparison import compare
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.result import Identification

identifying = importlib.import_module("reduced_models.identification.laws_of_record")


def spiked() -> PistonRecord:
    """Sixteen samples a cycle of a linear motion, one of them far off."""
    time = np.arange(0.0, 10.0, 1.0 / 16.0)
    height = 0.06 + 1e-3 * np.exp(-0.1 * time) * np.cos(2.0 * np.pi * time)
    height += np.random.default_rng(0).normal(0.0, 1e-5, len(time))
    height[80] -= 4e-4
    return PistonRecord(time, height)


def identified(record: PistonRecord) -> Identification:
    """Linear and Coulomb laws of a record."""
    return identify(record, laws=["linear", "coulomb"], starts=2, progress=False)


def test_a_spike_is_left_out_and_noted_unless_the_record_is_complete() -> None:
    record = spiked()
    with pytest.warns(RecordWarning, match="spikes"):
        found = identified(record)
    assert len(found.record) == len(record) - 1
    words = "single samples that stand far off the fitted motion (spikes: 1, the first at 5 s) are left out; "
    assert f"{words}to keep them: complete=True of the PistonRecord" in " ".join(str(found).split())
    assert len(identified(dataclasses.replace(record, complete=True)).record) == len(record)


@pytest.mark.parametrize("fitted", [1, 0])
def test_the_finished_comparison_stays_where_the_second_has_no_time(
    monkeypatch: pytest.MonkeyPatch, fitted: int
) -> None:
    """No law that was fitted is lost to a budget that ends in the second comparison."""
    record = spiked()

    def compare_in_time(samples: PistonRecord, laws: Any, **how: Any) -> Comparison:
        if len(samples) < len(record) and not fitted:
            raise InputError("no law could be fitted")
        table = compare(samples, laws, **how)
        if len(samples) == len(record):
            return table
        spent = (dataclasses.replace(row, models=(), failure="spent") for row in table.rows[fitted:])
        return dataclasses.replace(table, rows=(*table.rows[:fitted], *spent))

    monkeypatch.setattr(identifying, "compare", compare_in_time)
    with pytest.warns(RecordWarning, match="stay: not all laws"):
        found = identified(record)
    assert len(found.record) == len(record)
    assert {row.name for row in found.comparison.rows if row.models} == {"linear", "coulomb"}
    assert "raise --budget" in " ".join(str(found).split())
