"""All programs that the benchmark compares compute the same pair sum."""

import sys

import numpy as np
import pytest

from benchmarks import available_engines, c_kernel, peers
from benchmarks.other_engines import lammps, openmm
from benchmarks.peers import plain_verlet_list, verlet_list_workspace
from benchmarks.process import ProcessError, finished
from benchmarks.sums import (
    PaddedGrains,
    arrangement,
    by_cut_off,
    by_plain_list,
    direct,
    direct_sums,
    exact_forces,
    exponent,
    in_c,
    in_jax,
    plain,
)


@pytest.mark.parametrize("way", [plain, direct, in_jax, in_c])
def test_numpy_jax_c_and_numba_give_the_same_pair_sum(way) -> None:
    if way is in_c and c_kernel.missing():
        pytest.skip(c_kernel.missing())
    positions = arrangement(93)
    entry = way(PaddedGrains(positions))
    entry.call()
    force, magnitude = exact_forces(positions)
    assert (np.abs(entry.force() - force).max(axis=1) < 1e-13 * magnitude).all()


@pytest.mark.long
def test_sum_by_a_simple_pair_list_equals_the_cut_off_sum_while_grains_move() -> None:
    positions = arrangement(400)
    one, other = by_cut_off(positions), by_plain_list(positions)
    for _ in range(5):
        one.call()
        other.call()
        # Some grains pass each other closely, with forces a million times larger.
        scale = np.abs(other.force()).max()
        np.testing.assert_allclose(one.force(), other.force(), rtol=1e-12, atol=1e-13 * scale)


def test_a_full_pair_list_raises_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs in plain Python, since only long tests compile the list."""
    grains = PaddedGrains(arrangement(200))
    sums = grains.sums()
    fill, summed = (getattr(one, "py_func", one) for one in (peers._fill, plain_verlet_list))
    monkeypatch.setattr(peers, "_fill", fill)
    with pytest.raises(ValueError, match="the list is full"):
        summed(verlet_list_workspace(200, 3), 11.0, 1.0, grains.x, grains.y, sums[0], sums[1], 200)


def test_benchmark_rows_of_pair_sums_give_grain_count_time_and_error() -> None:
    rows = direct_sums(92, rounds=1)
    assert {row["grains"] for row in rows} == {92}
    ours = [row for row in rows if not row["sum"].startswith(("LAMMPS", "OpenMM"))]
    assert len(ours) >= 4
    assert all(row["seconds"] > 0.0 and row["error"] < 1e-13 for row in ours)
    assert rows[0]["ns per pair"] == pytest.approx(1e9 * rows[0]["seconds"] / (92 * 91 / 2))
    assert {row["sum"]: row["over direct"] for row in rows}["direct sum"] == 1.0


def test_exponent_of_a_power_law_is_recovered() -> None:
    counts = np.array([1e3, 3e3, 1e4, 3e4])
    slope, half = exponent(counts, 2e-7 * counts**1.5)
    assert slope == pytest.approx(1.5, abs=1e-12)
    assert half < 1e-9


def test_confidence_interval_of_an_exponent_has_its_stated_coverage(random: np.random.Generator) -> None:
    counts = np.array([1e3, 2e3, 5e3, 2e4, 1e5])
    inside = 0
    for _ in range(1000):
        times = 1e-7 * counts**1.1 * np.exp(random.normal(0.0, 0.1, len(counts)))
        slope, half = exponent(counts, times)
        inside += abs(slope - 1.1) < half
    assert 920 <= inside <= 980


TOLERANCES = {lammps.TABLE: 1e-4, lammps.EXACT: 1e-13}
SINGLE = 1e-4
"""Error of single precision in a sum of 92 terms, relative to the sum of magnitudes."""


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return arrangement(93)


def error(force: np.ndarray, positions: np.ndarray) -> float:
    exact, magnitude = exact_forces(positions)
    return float((np.abs(force - exact).max(axis=1) / magnitude).max())


@pytest.mark.parametrize("style", TOLERANCES)
def test_lammps_gives_the_same_pair_sum(positions: np.ndarray, style: str) -> None:
    if lammps.missing():
        pytest.skip(lammps.missing())
    found = lammps.steps(positions, style, count=2)
    assert found.seconds > 0.0
    assert error(found.force, positions) < TOLERANCES[style]


def test_lammps_omits_pairs_beyond_the_cut_off_distance(positions: np.ndarray) -> None:
    if lammps.missing():
        pytest.skip(lammps.missing())
    found = lammps.steps(positions, lammps.TABLE, count=2, cut=5.0)
    delta = positions[:, None] - positions
    r = np.linalg.norm(delta, axis=2)
    r[(r == 0.0) | (r > 5.0)] = np.inf
    near = (0.75 * delta / r[:, :, None] ** 5).sum(axis=1)
    scale = (0.75 / r**4).sum(axis=1)
    assert (np.abs(found.force - near).max(axis=1) < 1e-4 * scale).all()


@pytest.mark.parametrize("platform", openmm.PLATFORMS)
def test_openmm_gives_the_same_pair_sum(positions: np.ndarray, platform: str) -> None:
    if openmm.missing():
        pytest.skip(openmm.missing())
    step, forces = openmm.steps(positions, platform)
    step()
    assert error(forces(), positions) < (1e-13 if platform == "Reference" else SINGLE)


def test_engines_absent_from_the_wheel_are_reported_as_available_only_from_a_checkout(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in available_engines.NAMES:
        monkeypatch.setitem(sys.modules, f"{available_engines.FOLDER}.{name}", None)  # as if missing
        assert available_engines.engine(name) is None
        assert "only from a checkout" in str(available_engines.unavailability_reason(name))


def test_a_failed_benchmark_process_raises_a_process_error() -> None:
    with pytest.raises(ProcessError, match="ended with 3: no place"):
        finished(["python", "-c", "import sys; print('no place', file=sys.stderr); sys.exit(3)"])
