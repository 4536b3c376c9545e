"""What the benchmark compares is the same sum, and its report says what was measured."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from validation.__main__ import parser
from validation.benchmark import c_kernel, programme
from validation.benchmark.peers import plain_verlet_list, verlet_list_room
from validation.benchmark.sums import (
    Grains,
    arrangement,
    by_cut_off,
    by_plain_list,
    cut_off_sums,
    direct,
    direct_sums,
    exact_forces,
    exponent,
    in_c,
    in_jax,
    plain,
)


@pytest.mark.parametrize("way", [plain, direct, in_jax, in_c])
def test_every_way_sums_the_same(way) -> None:
    if way is in_c and c_kernel.missing():
        pytest.skip(c_kernel.missing())
    positions = arrangement(93)
    entry = way(Grains(positions))
    entry.call()
    force, magnitude = exact_forces(positions)
    assert (np.abs(entry.force() - force).max(axis=1) < 1e-13 * magnitude).all()


def test_lists_of_moving_grains_agree() -> None:
    positions = arrangement(400)
    one, other = by_cut_off(positions), by_plain_list(positions)
    for _ in range(5):
        one.call()
        other.call()
        # Some grains pass each other closely, with forces that are a million times greater.
        scale = np.abs(other.force()).max()
        np.testing.assert_allclose(one.force(), other.force(), rtol=1e-12, atol=1e-13 * scale)


def test_full_list_is_refused() -> None:
    grains = Grains(arrangement(200))
    sums = grains.sums()
    with pytest.raises(ValueError, match="the list is full"):
        plain_verlet_list(
            verlet_list_room(200, 3), 11.0, 1.0, grains.x, grains.y, sums[0], sums[1], 200
        )


def test_rows_say_what_was_measured() -> None:
    rows = direct_sums(92, rounds=1)
    assert {row["grains"] for row in rows} == {92}
    assert all(row["seconds"] > 0.0 and row["error"] < 1e-13 for row in rows)
    assert rows[0]["ns per pair"] == pytest.approx(1e9 * rows[0]["seconds"] / (92 * 91 / 2))
    near = cut_off_sums(200, rounds=1)
    assert [row["sum"] for row in near] == ["plain Verlet list", "cut-off"]


def test_exponent_of_a_power_law() -> None:
    counts = np.array([1e3, 3e3, 1e4, 3e4])
    slope, error = exponent(counts, 2e-7 * counts**1.5)
    assert slope == pytest.approx(1.5, abs=1e-12)
    assert error < 1e-9
    _, error = exponent(counts, 2e-7 * counts**1.5 * np.array([1.0, 1.3, 0.8, 1.1]))
    assert 0.03 < error < 0.3


def test_report_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measurements(full: bool) -> Iterator[tuple]:
        for count in (1000, 2000, 4000):
            row = {"sum": "direct sum", "grains": count, "seconds": 1e-9 * count**2,
                   "ns per pair": 2.0, "times plain": 8.0, "error": 1e-15}  # fmt: skip
            yield "direct", "direct", lambda row=row: [row]
        yield (
            "absent",
            "absent",
            lambda: [
                {"effects": "dipole", "grains": 92, "by hand": 1e-6, "engine": 2e-6, "ratio": 2.0}
            ],
        )

    monkeypatch.setattr(programme, "_measurements", measurements)
    found = programme.benchmark(str(tmp_path), progress=False)
    assert found["growth"][0]["exponent"] == pytest.approx(2.0)
    kept = json.loads((tmp_path / "benchmark.json").read_text())
    assert kept["direct"][0]["grains"] == 1000
    text = (tmp_path / "benchmark.txt").read_text()
    assert "direct sum" in text
    assert "2.000 +- 0.000" in text
    assert "near pairs" not in text
    assert (tmp_path / "benchmark.svg").stat().st_size > 1000


def test_command_line_has_the_benchmark() -> None:
    options = parser().parse_args(["benchmark", "--quick", "--json"])
    assert options.command == "benchmark"
    assert options.json
    assert not options.full
