"""Other programs that the benchmark runs compute the same forces."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from benchmarks import available_engines
from benchmarks.other_engines import lammps, openmm
from benchmarks.process import ProcessError, finished
from benchmarks.sums import arrangement, exact_forces

TOLERANCES = {lammps.TABLE: 1e-4, lammps.EXACT: 1e-13}
SINGLE = 1e-4
"""Single precision, in a sum of 92 terms, leaves this of the sum of magnitudes."""


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    return arrangement(93)


def error(force: np.ndarray, positions: np.ndarray) -> float:
    exact, magnitude = exact_forces(positions)
    return float((np.abs(force - exact).max(axis=1) / magnitude).max())


@pytest.mark.parametrize("style", TOLERANCES)
def test_lammps_sums_the_same(positions: np.ndarray, style: str) -> None:
    if lammps.missing():
        pytest.skip(lammps.missing())
    found = lammps.steps(positions, style, count=2)
    assert found.seconds > 0.0
    assert error(found.force, positions) < TOLERANCES[style]


def test_lammps_ends_pairs_at_the_cut_off(positions: np.ndarray) -> None:
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
def test_openmm_sums_the_same(positions: np.ndarray, platform: str) -> None:
    if openmm.missing():
        pytest.skip(openmm.missing())
    step, forces = openmm.steps(positions, platform)
    step()
    assert error(forces(), positions) < (1e-13 if platform == "Reference" else SINGLE)


def test_engines_that_the_wheel_leaves_out_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in available_engines.NAMES:
        monkeypatch.setitem(sys.modules, f"{available_engines.FOLDER}.{name}", None)  # as if not there
        assert available_engines.engine(name) is None
        assert "from the sources only" in str(available_engines.why_not(name))


def test_process_that_fails_is_a_typed_error() -> None:
    with pytest.raises(ProcessError, match="ended with 3: no place"):
        finished(["python", "-c", "import sys; print('no place', file=sys.stderr); sys.exit(3)"])
