"""Random laws are read, or refused in one line."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.mark.parametrize("count", [250, pytest.param(5000, marks=pytest.mark.long)])
def test_laws_are_read_or_refused(outcomes: Any, count: int) -> None:
    found = outcomes("law_texts.py", "--count", str(count))
    assert found["read"] + found["refused"] == count
    assert min(found.values()) > count // 10
