"""Stamps of dates are seconds since the first, whatever their zone, and without a word."""

import warnings

import numpy as np
import pytest

from granular.records.sheet import parse_timestamps


@pytest.mark.parametrize("zone", ["", "Z", "+02:00", "-0530"])
def test_dates_with_and_without_a_zone(zone: str) -> None:
    cells = [f"2024-05-03T23:59:59.{ms:03d}{zone}" for ms in (0, 4, 8)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = parse_timestamps([*cells, "NaN"])
    assert found is not None
    seconds, kind = found
    assert kind == "date"
    np.testing.assert_allclose(seconds, [0.0, 0.004, 0.008, np.nan], rtol=0.0, atol=1e-12)


def test_zones_that_differ_count_from_the_same_moment() -> None:
    found = parse_timestamps(["2024-10-27T02:59:59+02:00", "2024-10-27T02:00:01+01:00"])
    assert found is not None
    assert found[0].tolist() == [0.0, 2.0]
