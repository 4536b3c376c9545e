"""The range in which a law may stand in for a shaken bed."""

from __future__ import annotations

import pytest

from granular import damper
from granular.shared.errors import InputError
from reduced_models import valid_shaking_range
from reduced_models.falls.predicted_law import RESPONSE_ERROR
from tests.reduced_models.falls.pushed import PUSHED


def test_errors_are_those_that_were_measured() -> None:
    worst = max(abs(row.by_law / row.simulated - 1.0) for row in PUSHED if row.by_law < 2.0)
    assert 0.9 * RESPONSE_ERROR < worst <= RESPONSE_ERROR


def test_amplitudes_go_with_the_size_of_the_bed() -> None:
    small, large = valid_shaking_range(damper()), valid_shaking_range(damper(count=4 * 368))
    assert small.amplitudes == pytest.approx((0.003, 0.009))
    assert large.amplitudes == pytest.approx((0.006, 0.018))
    assert small.frequencies == large.frequencies


def test_a_bed_of_which_nothing_is_known_is_refused() -> None:
    with pytest.raises(InputError, match="has friction"):
        valid_shaking_range(damper().replace(**{"effects.friction": True}))
