"""A warm cache: later starts compile nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).parents[3]


def command(cache: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "granular", *words, "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_after_a_warm_up_a_run_compiles_nothing(tmp_path: Path) -> None:
    told = json.loads(command(tmp_path, "scenes", "--warm-up", "single-particle"))
    assert Path(told["folder"]).parent == tmp_path
    assert list(told["seconds"]) == ["single-particle"]
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.kernel")}
    assert kept
    command(tmp_path, "run", "single-particle", "--t-end", "0.1", "--quiet")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.kernel")} == kept
