"""Random scenes, records and laws of motion are accepted or refused in one line; crashes do not occur."""

import json
import math
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.usefixtures("interruptible")


def check(cases: list[dict[str, Any]], count: int) -> None:
    found = Counter(case["outcome"] for case in cases)
    print(dict(found))
    assert len(cases) == count
    assert set(found) <= {"fine", "refused", "stopped", "cut"}
    assert min(found["fine"], found["refused"]) > 0.1 * count


def test_twenty_random_scenes_run_or_are_refused_with_one_line(tried: Any) -> None:
    words = ("--count", "20", "--seconds", "0.5")
    check(tried("scenes.py", *words, compiled=False), 20)


def test_a_random_scene_depends_only_on_its_seed_and_number() -> None:
    """The random order of Python's sets does not affect it."""
    code = "from scene_cases import Case; print([Case(1, number).plain for number in range(40)])"
    here = Path(__file__).parent
    paths = os.pathsep.join((str(here), str(here.parents[1])))

    def drawn(order: str) -> str:
        surroundings = os.environ | {"PYTHONPATH": paths, "PYTHONHASHSEED": order}
        return subprocess.check_output([sys.executable, "-c", code], env=surroundings, text=True)

    assert drawn("1") == drawn("2")


@pytest.mark.long
def test_5000_random_scenes_run_or_are_refused_with_one_line(tried: Any) -> None:
    check(tried("scenes.py", "--count", "5000", compiled=False), 5000)


@pytest.mark.long
def test_random_scenes_give_the_same_result_compiled_and_in_plain_python(tried: Any) -> None:
    """To limit compilation, the 300 scenes use only frequently used effects."""
    words = ("--count", "300", "--common", "--seconds", "20", "--figures")
    compiled, plain = tried("scenes.py", *words), tried("scenes.py", *words, compiled=False)
    check(compiled, 300)
    for one, other in zip(compiled, plain, strict=True):
        if "cut" not in (one["outcome"], other["outcome"]):
            assert one["outcome"] == other["outcome"], one["case"]
        if one["outcome"] == other["outcome"] == "fine":
            assert_same(json.loads(one["what"]), json.loads(other["what"]), one["case"])


def assert_same(one: dict[str, float], other: dict[str, float], case: int) -> None:
    """Assert equality up to rounding errors, which hardly grow in a few steps."""
    assert set(one) == set(other)
    energy = max((abs(one[name]) for name in one if name.endswith("_energy")), default=0.0)
    for name, value in one.items():
        least = max(1e-9 * energy, 1e-100) if name.endswith(("_energy", "_loss", "work")) else 1e-12
        close = math.isclose(value, other[name], rel_tol=1e-6, abs_tol=least)
        assert close or math.isnan(value), (case, name, value, other[name])


@pytest.mark.parametrize("count", [80, pytest.param(5000, marks=pytest.mark.long)])
def test_random_records_are_read_or_refused_with_one_line(tried: Any, count: int) -> None:
    found = Counter(case["outcome"] for case in tried("records.py", "--count", str(count)))
    assert found["read"] + found["refused"] == count
    assert min(found.values()) > count // 10


@pytest.mark.long
def test_random_records_are_fitted_or_refused_with_one_line(tried: Any) -> None:
    found = Counter(case["outcome"] for case in tried("fits.py", "--count", "60"))
    assert found["fitted"] + found["refused"] == 60
    assert found["fitted"] > 15


@pytest.mark.parametrize("count", [100, pytest.param(5000, marks=pytest.mark.long)])
def test_random_texts_of_laws_are_read_or_refused_with_one_line(tried: Any, count: int) -> None:
    found = Counter(case["outcome"] for case in tried("law_texts.py", "--count", str(count)))
    assert found["read"] + found["refused"] == count
    assert min(found.values()) > count // 10
