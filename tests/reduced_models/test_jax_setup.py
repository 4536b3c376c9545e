"""The folder for code compiled by JAX, and stop signals, forks and devices."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
CODE = """
from reduced_models.jax_setup import jax
print(jax.config.jax_compilation_cache_dir)
print(jax.jit(lambda x: 2.0 * x + 1.0)(3.0))
"""


def run(folder: Path, kept: str = "") -> tuple[list[str], str]:
    """Return the output and the warnings of code that runs with a separate home directory."""
    changes = {"HOME": str(folder / "home"), "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": ""}
    words, environment = [sys.executable, "-c", CODE], changes | {"JAX_COMPILATION_CACHE_DIR": kept}
    done = subprocess.run(
        words, check=True, capture_output=True, text=True, cwd=folder, env=os.environ | environment
    )
    return done.stdout.splitlines(), done.stderr


def test_code_compiled_by_jax_is_kept_in_the_cache_folder_of_the_user(tmp_path: Path) -> None:
    """An empty ``XDG_CACHE_HOME`` is ignored, and nothing is written to the working directory."""
    kept = tmp_path / "home" / ".cache" / "granular-damper" / "jax"
    assert run(tmp_path) == ([str(kept), "7.0"], "")
    assert list(kept.iterdir())
    assert list(tmp_path.iterdir()) == [tmp_path / "home"]


@pytest.mark.long  # quick: `trusted_cache_folder` in tests/granular/shared/test_files.py
def test_a_folder_writable_by_others_is_not_used_as_cache_for_jax(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    printed, complaint = run(tmp_path, str(shared))
    assert printed == ["None", "7.0"]
    assert "others may write to it" in complaint
    assert not list(shared.iterdir())


@pytest.mark.usefixtures("interruptible")
def test_a_stop_signal_waits_until_jax_has_compiled() -> None:
    """An interrupted compilation printed a hundred lines or ended the process."""
    from reduced_models.jax_setup import Compiled

    done = []

    @Compiled
    def inner(x: float) -> float:
        os.kill(os.getpid(), signal.SIGINT)
        return 2.0 * x

    @Compiled
    def outer(x: float) -> float:
        result = inner(x) + 1.0
        done.append(x)
        return result

    with pytest.raises(KeyboardInterrupt):
        outer(3.0)
    assert len(done) == 1
    assert outer(3.0) == 7.0
    assert len(done) == 1


FORKED = """
import multiprocessing, warnings
from reduced_models.jax_setup import Compiled
function = Compiled(lambda x: 2.0 * x + 1.0)
def compute(x):
    return float(function(x))
warnings.simplefilter("ignore")  # JAX warns of the fork itself
if {used}:
    compute(1.0)
with multiprocessing.get_context("fork").Pool(1) as pool:
    try:
        print(pool.map(compute, [3.0]))
    except Exception as error:
        print(error)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is forked")
@pytest.mark.parametrize("used", [False, True])
def test_a_fork_of_a_process_that_has_used_jax_is_refused_at_once(used: bool) -> None:
    """The fork would wait forever for threads that it does not have."""
    words = [sys.executable, "-c", FORKED.format(used=used)]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=60, check=True)
    if used:
        assert (
            "and JAX would hang in it; start processes with multiprocessing.get_context('spawn')"
            in done.stdout
        )
    else:
        assert done.stdout == "[7.0]\n"


def test_a_missing_device_for_jax_is_reported_in_one_line(process: Callable, tmp_path: Path) -> None:
    record = tmp_path / "lab.csv"
    record.write_text("time,height\n" + "".join(f"{k},{k % 7}\n" for k in range(40)))
    done = process("reduced_models", "fit", str(record), "--law", "linear", JAX_PLATFORMS="nonsense")
    assert done.returncode == 2
    assert done.stderr.startswith("error: JAX_PLATFORMS = 'nonsense', which JAX cannot use here")
    assert done.stderr.count("\n") == 1


def test_a_cached_jax_program_is_loaded_without_tracing_the_function(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A function is traced if the file is damaged, has another name or other types, or calls LAPACK."""
    from reduced_models import jax_setup

    monkeypatch.setattr(jax_setup, "_folder", tmp_path)
    traced = []

    def fresh(form: str, x: Any) -> Any:
        def double(x: Any) -> Any:
            traced.append(x)
            return 2.0 * x

        return jax_setup.Compiled(double, form)(x)

    assert fresh("a", 3.0) == fresh("a", 4.0) - 2.0 == 6.0
    assert len(traced) == 1
    assert fresh("b", 3.0) == 6.0
    assert fresh("a", np.array([3.0])).tolist() == [6.0]
    assert len(traced) == 3
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    assert fresh("a", 5.0) == 10.0
    assert len(traced) == 4

    for _ in range(2):

        def root(matrix: Any) -> Any:
            traced.append(matrix)
            return jax_setup.jax.numpy.linalg.cholesky(matrix)

        assert jax_setup.Compiled(root, "root")(4.0 * np.eye(2))[0, 0] == 2.0
    assert len(traced) == 6
