"""Where JAX keeps what it compiled."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = """
from reduced_models.jax_setup import jax
print(jax.config.jax_compilation_cache_dir)
print(jax.jit(lambda x: 2.0 * x + 1.0)(3.0))
"""


def run(folder: Path, **environment: str) -> tuple[list[str], str]:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=os.environ
        | {
            "HOME": str(folder / "home"),
            "PYTHONPATH": str(ROOT),
            "XDG_CACHE_HOME": "",
            "JAX_COMPILATION_CACHE_DIR": "",
        }
        | environment,
    )
    return done.stdout.splitlines(), done.stderr


def test_code_is_kept_among_the_caches_of_the_user(tmp_path: Path) -> None:
    """An empty ``XDG_CACHE_HOME`` is none, and nothing is left in the working directory."""
    kept = tmp_path / "home" / ".cache" / "granular-damper" / "jax"
    assert run(tmp_path) == ([str(kept), "7.0"], "")
    assert list(kept.iterdir())
    assert list(tmp_path.iterdir()) == [tmp_path / "home"]


@pytest.mark.long  # quick: `trusted_cache_folder` in tests/granular/shared/test_caches.py
def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    printed, said = run(tmp_path, JAX_COMPILATION_CACHE_DIR=str(shared))
    assert printed == ["None", "7.0"]
    assert "others may write to it" in said
    assert not list(shared.iterdir())


@pytest.mark.parametrize("platform", [pytest.param("cuda", marks=pytest.mark.long), "nonsense"])
def test_a_device_that_is_not_there_is_said_in_one_line(
    process: Callable, tmp_path: Path, platform: str
) -> None:
    if platform == "cuda" and importlib.util.find_spec("jax_cuda12_plugin"):
        pytest.skip("JAX may find one here")
    record = tmp_path / "lab.csv"
    record.write_text("time,height\n" + "".join(f"{k},{k % 7}\n" for k in range(40)))
    done = process("reduced_models", "fit", str(record), "--law", "linear", JAX_PLATFORMS=platform)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: JAX_PLATFORMS = {platform!r}, which JAX cannot use here")
    assert done.stderr.count("\n") == 1
