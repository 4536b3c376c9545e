"""An editable copy of the package, and a process that compiles a few of its kernels."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

# Only the constants that the kernels read: making a scene takes longer than compiling the kernels.
CONSTANTS = """
from typing import Any, NamedTuple

class Acting(NamedTuple):
    laws: Any
    dipole: Any = None
    near: Any = None

class Constants(NamedTuple):
    acting: Any
    grains: int = 92
    minimum_mass: float = 1.0
    minimum_moment: float = 1.0
    minimum_ratio: float = 1.0
"""

# Calls kernels of four files, and compiles some ten of them.
CODE = """
from granular.effects.wall_laws import ExperimentalWall
from granular.effects.wall_laws import CellSidesWithLaws
from granular.effects.wall_side import Side
from granular.engine.step_size import highest_impact_frequency_from_python
from granular.few_constants import Acting, Constants
walls = CellSidesWithLaws((Side(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0, ExperimentalWall()),) * 4)
print(highest_impact_frequency_from_python(Constants(Acting((walls,))), 2.0))
"""


class Workshop:
    """A folder with an editable copy of the package and a separate cache of compiled code."""

    code = CODE

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        skipped = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "granular", folder / "granular", ignore=skipped)
        (folder / "granular" / "few_constants.py").write_text(CONSTANTS, encoding="utf-8")

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
        """Run code in a process, assert that it succeeds, and return standard output and standard error."""
        process = self.start(code, cache)
        said = process.communicate(timeout=300)
        assert process.returncode == 0, said[1]
        return said

    def kernels(self) -> dict[Path, int]:
        """Return the files of compiled code with their modification times [ns]."""
        return {path: path.stat().st_mtime_ns for path in self.cache.rglob("*.kernel")}

    def edit(self, name: str, old: str, new: str) -> None:
        path = self.folder / "granular" / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.fixture
def fresh_workshop(tmp_path: Path) -> Workshop:
    """Return a new copy of the package whose files may be edited."""
    return Workshop(tmp_path)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """Return a copy shared by several tests, since compilation is slow. Tests may damage its cache."""
    return Workshop(tmp_path_factory.mktemp("workshop"))
