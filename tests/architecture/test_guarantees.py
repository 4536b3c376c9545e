"""Every guarantee listed in docs/results/guarantees.md cites existing tests."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results" / "guarantees.md").read_text(encoding="utf-8")
TESTS = sorted(set(re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)))


@pytest.mark.parametrize(("file", "name"), TESTS, ids=["::".join(one) for one in TESTS])
def test_every_test_cited_on_the_page_of_guarantees_exists(file: str, name: str) -> None:
    assert f"\ndef {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_every_item_on_the_page_of_guarantees_cites_a_test() -> None:
    items = re.findall(r"^- (.*?)(?=^- |^#|^$)", PAGE, flags=re.MULTILINE | re.DOTALL)
    assert len(items) > 20
    assert [item for item in items if "::test_" not in item] == []
