"""The cache of compiled code is never stale."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CODE = """
import numpy as np
from granular import load_scene, evaluate
scene = load_scene("bed").replace(**{"effects.dipole": None, "effects.gravity": None})
print(evaluate(scene, scene.initial_motion()[0]).piston_force)
"""


def test_editing_a_callee_compiles_its_callers_afresh(tmp_path: Path) -> None:
    """The walls' caller stands in another file than the law; Numba alone would not notice."""
    shutil.copytree(ROOT / "granular", tmp_path / "granular",
                    ignore=shutil.ignore_patterns("__pycache__"))  # fmt: skip

    def force() -> float:
        done = subprocess.run(
            [sys.executable, "-c", CODE], cwd=tmp_path, capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
                 "PYTHONPATH": str(tmp_path)},
        )  # fmt: skip
        return float(done.stdout)

    before = force()
    law = tmp_path / "granular" / "effects" / "wall_experimental.py"
    law.write_text(law.read_text().replace("STRENGTH = 0.5", "STRENGTH = 1.0"))
    assert abs(force() / before - 2.0) < 1e-12
