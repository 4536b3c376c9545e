"""The package's size is that of its files, without what a wheel leaves out."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import package
from benchmarks.package import IMPORTS, packed_size

ROOT = Path(__file__).parents[2]


def test_size_is_that_of_the_files_packed() -> None:
    files = [
        path
        for package in ("granular", "reduced_models", "validation")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    integer = sum(path.stat().st_size for path in files)
    assert 0.1 * integer < packed_size() < 0.7 * integer
    assert packed_size() < 2_000_000  # a package of text and a few tables


def test_rows_hold_the_size_and_every_import(monkeypatch: pytest.MonkeyPatch) -> None:
    light = IMPORTS[:2]  # the others take seconds
    monkeypatch.setattr(package, "IMPORTS", light)
    rows = package.package_figures(rounds=1)
    assert rows[0]["bytes"] == packed_size()
    assert [row["what"] for row in rows[2:]] == list(light[1:])
