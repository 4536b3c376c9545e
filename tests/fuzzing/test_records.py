"""Random records, and fits of them: figures are finite, or one line says why there are none."""

from collections import Counter
from typing import Any

import pytest


@pytest.mark.parametrize("count", [80, pytest.param(5000, marks=pytest.mark.long)])
def test_records_are_read_or_refused(tried: Any, count: int) -> None:
    found = Counter(case["outcome"] for case in tried("records.py", "--count", str(count)))
    assert found["read"] + found["refused"] == count
    assert min(found.values()) > count // 10


@pytest.mark.long
def test_records_are_fitted_or_refused(tried: Any) -> None:
    found = Counter(case["outcome"] for case in tried("fits.py", "--count", "60"))
    assert found["fitted"] + found["refused"] == 60
    assert found["fitted"] > 15
