"""A copy of the package that may be edited, and a process that compiles a few of its kernels."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

# Calls kernels of four files, and compiles some ten of them.
CODE = """
from granular import load_scene
from granular.engine.frequency_bounds import evaluate_highest_impact_frequency
from granular.scene.scene_in_natural_units import scene_in_natural_units
scene = load_scene("bed").replace(**{"effects.dipole": None})
print(evaluate_highest_impact_frequency(scene_in_natural_units(scene).constants, 2.0))
"""


class Workshop:
    """A folder with a copy of the package and a cache of its own."""

    code = CODE

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        skipped = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "granular", folder / "granular", ignore=skipped)

    def start(self, code: str = CODE, cache: str | None = None) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=self.folder,
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": str(self.cache) if cache is None else cache,
                "PYTHONPATH": str(self.folder),
                "HOME": str(self.folder / "home"),
                "XDG_CACHE_HOME": "",
            },
        )

    def run(self, code: str = CODE, cache: str | None = None) -> tuple[str, str]:
        """What a process prints and what it says besides; it must not fail."""
        process = self.start(code, cache)
        said = process.communicate(timeout=300)
        assert process.returncode == 0, said[1]
        return said

    def kernels(self) -> dict[Path, int]:
        """The files of compiled code, with the time at which each was written."""
        return {path: path.stat().st_mtime_ns for path in self.cache.rglob("*.kernel")}

    def edit(self, name: str, old: str, new: str) -> None:
        path = self.folder / "granular" / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.fixture
def fresh_workshop(tmp_path: Path) -> Workshop:
    """One whose files may be edited."""
    return Workshop(tmp_path)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """One that tests share, since compiling takes long; its cache is theirs to spoil."""
    return Workshop(tmp_path_factory.mktemp("workshop"))
