"""Random scenes are run, refused, or stopped by an error of ours: nothing else becomes of them."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest


def check(found: Counter[str], count: int) -> None:
    assert sum(found.values()) == count
    assert set(found) <= {"fine", "refused", "stopped", "cut"}
    assert min(found["fine"], found["refused"]) > 0.1 * count


def test_some_random_scenes(outcomes: Any) -> None:
    words = ("--count", "20", "--seconds", "0.5")
    check(outcomes("scenes.py", *words, compiled=False), 20)


@pytest.mark.long
def test_many_random_scenes(outcomes: Any) -> None:
    check(outcomes("scenes.py", "--count", "5000", compiled=False), 5000)


@pytest.mark.long
def test_random_scenes_compiled(outcomes: Any) -> None:
    """The first of them whose effects are common."""
    check(outcomes("scenes.py", "--count", "300", "--common", "--seconds", "20"), 300)
