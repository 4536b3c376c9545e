"""All that acts also runs where numba does not compile, and keeps the ledger there.

Pytest runs in a process of its own, since numba is told once.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "words", [(), pytest.param(("-m", "long", "-k", "not whole_bed"), marks=pytest.mark.long)]
)
def test_small_runs_in_plain_python(words: tuple[str, ...], tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--basetemp={tmp_path / 'runs'}",
            *words,
            "tests/plain_python",
            "tests/physics/test_forces.py::test_force_is_minus_gradient",
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout.splitlines()[-1]
