"""Random laws are read, or refused in one line."""

from collections import Counter
from typing import Any

import pytest


@pytest.mark.parametrize("count", [100, pytest.param(5000, marks=pytest.mark.long)])
def test_laws_are_read_or_refused(tried: Any, count: int) -> None:
    found = Counter(case["outcome"] for case in tried("law_texts.py", "--count", str(count)))
    assert found["read"] + found["refused"] == count
    assert min(found.values()) > count // 10
