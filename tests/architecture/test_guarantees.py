"""Every promise of the guide names existing tests."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results" / "guarantees.md").read_text(encoding="utf-8")
TESTS = sorted(set(re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)))


@pytest.mark.parametrize(("file", "name"), TESTS, ids=["::".join(one) for one in TESTS])
def test_named_tests_exist(file: str, name: str) -> None:
    assert f"\ndef {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_every_promise_names_a_test() -> None:
    """Each item of the lists is a promise."""
    items = re.findall(r"^- (.*?)(?=^- |^#|^$)", PAGE, flags=re.MULTILINE | re.DOTALL)
    assert len(items) > 20
    assert [item for item in items if "::test_" not in item] == []
