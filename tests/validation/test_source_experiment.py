"""The source's test of its method: compensated sums have its order, the position form rounds."""

from __future__ import annotations

import json

import pytest

from validation.exact import bounce
from validation.source_experiment import (
    COMPENSATED,
    PLAIN,
    STEPS,
    TOOLKIT,
    SourceExperiment,
    SourceRun,
    _form,
    source_experiment,
)


def forms(*steps: float) -> SourceExperiment:
    exact = float(bounce.problem().exact(bounce.TIME).positions[0, 1])
    return SourceExperiment(
        tuple(_form(form, step, exact) for form in (PLAIN, COMPENSATED) for step in steps)
    )


@pytest.fixture(scope="module")
def coarse() -> SourceExperiment:
    return forms(*STEPS[:4])


def test_compensated_increments_have_order_two(coarse: SourceExperiment) -> None:
    assert coarse.slope(COMPENSATED) == pytest.approx(2.0, abs=0.01)
    assert all(one.peaks is not None and one.peaks < 1e-12 for one in coarse.of(COMPENSATED))


def test_the_position_form_is_rounding(coarse: SourceExperiment) -> None:
    """The error grows as the step shrinks, and all of it is what the forms differ by."""
    for one in coarse.of(PLAIN):
        assert coarse.rounding()[one.step] == pytest.approx(one.error, rel=0.1)
    assert coarse.of(PLAIN)[-1].error > 1e4 * coarse.of(COMPENSATED)[-1].error


def test_experiment_survives_json(coarse: SourceExperiment) -> None:
    again = SourceExperiment.from_dict(json.loads(json.dumps(coarse.to_dict())))
    assert again == coarse
    assert len(again.table().rows) == 8


def test_slopes_of_known_errors() -> None:
    runs = tuple(SourceRun(PLAIN, h, 1.0 + h**2, h**2, None, 0.0) for h in (1e-1, 1e-2, 1e-3))
    one = SourceExperiment(runs)
    assert one.slope(PLAIN, finest=1e-3) == pytest.approx(2.0)
    assert one.slope_to_finest(PLAIN) == pytest.approx(2.0, abs=0.01)


@pytest.mark.long
def test_the_whole_experiment() -> None:
    found = source_experiment(full=True)
    for form in (COMPENSATED, TOOLKIT):
        assert found.slope(form) == pytest.approx(2.0, abs=0.01)
    finest = found.of(COMPENSATED)[-1]
    assert finest.step == 1e-8
    assert finest.peaks is not None
    assert finest.peaks <= 1e-12
    printed = found.of(PLAIN)[-1].peaks
    assert printed is not None
    assert 1e-9 < printed < 1e-7  # rounding, of the size that the source prints
