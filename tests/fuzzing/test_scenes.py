"""Random scenes are run, refused, or stopped by an error of ours: nothing else becomes of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name("scenes.py")


def tried(*words: str, compiled: bool = False) -> list[dict[str, Any]]:
    """The cases that the program tried, in a process of its own, whose memory is limited."""
    paths = (str(ROOT), os.environ.get("PYTHONPATH", ""))
    surroundings = {
        "NUMBA_DISABLE_JIT": "0" if compiled else "1",
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
    }
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *words],
        cwd=ROOT, env=os.environ | surroundings, stdout=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    cases = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, cases[-1:]
    return cases


def check(cases: list[dict[str, Any]], count: int) -> None:
    outcomes = Counter(case["outcome"] for case in cases)
    print(dict(outcomes))
    assert [case for case in cases if case["outcome"] == "fault"] == []
    assert sum(outcomes.values()) == count
    assert outcomes["fine"] > 0.1 * count
    assert outcomes["refused"] > 0.1 * count


def test_some_random_scenes() -> None:
    check(tried("--count", "20", "--seconds", "0.5"), 20)


@pytest.mark.long
def test_many_random_scenes() -> None:
    check(tried("--count", "5000"), 5000)


@pytest.mark.long
def test_random_scenes_compiled() -> None:
    """The first of them whose effects are common."""
    check(tried("--count", "300", "--common", "--seconds", "20", compiled=True), 300)
