"""All effects also run without Numba's compiler, and their energy balance is closed.

Numba reads NUMBA_DISABLE_JIT only on import, so pytest runs in a separate process.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run_tests(folder: Path, words: tuple[str, ...], **environment: str) -> None:
    """Run some tests in a separate process, and check that none of them is skipped."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--basetemp={folder}", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"} | environment,
    )
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout.splitlines()[-1]


@pytest.mark.parametrize(
    "words", [("-m", "plain and not long"), pytest.param(("-m", "plain and long"), marks=pytest.mark.long)]
)
def test_tests_of_short_simulations_also_pass_in_plain_python(words: tuple[str, ...], tmp_path: Path) -> None:
    rooms = (ROOT / "tests" / name for name in ("granular", "physics"))
    files = (file for room in rooms for file in sorted(room.rglob("test_*.py")))
    marked = [str(file) for file in files if "@quick_in_plain_python" in file.read_text(encoding="utf-8")]
    run_tests(tmp_path / "runs", (*words, "tests/plain_python", *marked), NUMBA_DISABLE_JIT="1")


@pytest.mark.long  # quick: the same in plain Python, in which numpy checks every index
def test_compiled_code_stays_within_the_bounds_of_all_arrays(tmp_path: Path) -> None:
    file = "tests/plain_python/test_memory_bounds.py"
    run_tests(tmp_path / "runs", (file,), NUMBA_BOUNDSCHECK="1", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
