"""What the benchmark times is what its rows say."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.compression import PUBLISHED, compression
from benchmarks.engine import PAIR_METHODS
from benchmarks.fresh_process import peak_memory, starts
from benchmarks.pair_sum_errors import FORCES, forces_at_rest
from benchmarks.steps import EFFECTS, effect_steps, method_errors, method_steps


@pytest.mark.long
def test_rows_of_every_method_and_effect() -> None:
    rows = method_steps(92, rounds=1)
    assert [row["method"] for row in rows] == list(PAIR_METHODS)
    assert all(row["seconds"] > 0.0 for row in rows)
    found = effect_steps(92, rounds=1)
    assert [row["effect"] for row in found] == list(EFFECTS)
    assert found[0]["added"] == 0.0


@pytest.mark.long
def test_direct_sum_leaves_no_error_and_the_cut_off_does() -> None:
    rows = {row["method"]: row for row in method_errors(368)}
    assert rows["direct"]["force error"] == 0.0
    assert 1e-4 < rows["cut-off"]["force error"] < 1e-2
    assert rows["mesh"]["force error"] < 1e-3
    assert rows["direct"]["energy drift"] < 1e-4
    assert rows["mesh"]["energy drift"] < 1e-4


@pytest.mark.long
def test_mesh_leaves_the_forces_at_rest() -> None:
    """Within 0.05 % of the direct sum's; the cut-off takes off 2 % and more."""
    rows = {row["method"]: row for row in forces_at_rest(368)}
    assert rows["mesh"]["greatest_speed"] < 1e-5
    assert all(abs(rows["mesh"][f"{name} off"]) < 5e-4 for name in FORCES)
    assert rows["cut-off"]["piston_force off"] < -0.01


@pytest.mark.long
def test_memory_and_starts_come_from_other_processes() -> None:
    (row,) = peak_memory(20000, "cut-off")
    # Coordinates, velocities and forces alone take 48 bytes a grain.
    assert row["bytes"] - row["of 92 grains"] > 48 * 20000
    times = {row["start"].split(":")[0]: row["seconds"] for row in starts()}
    assert set(times) == {"import granular", "cold run", "warm run", "first step of a damper"}


@pytest.mark.long
def test_fast_compression_is_near_the_published_one() -> None:
    (row,) = compression(1, speed=0.1)
    assert row["simulated"] == pytest.approx(8.0 * 0.33 / 0.1, rel=1e-6)
    assert row["ledger"] < 1e-2
    assert row["force"] == pytest.approx(PUBLISHED["force"], rel=0.1)
    assert row["half distance"] == pytest.approx(PUBLISHED["half distance"], rel=0.02)
    assert np.isfinite(row["seconds"])
