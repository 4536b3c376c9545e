"""The toolkit's use of Numba's internals, and compilation without them."""

import importlib
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numba
import pytest

from granular.compiled.numba_insides import TESTED

ROOT = Path(__file__).parents[3]

INSIDES = {
    "granular/compiled/__init__.py": ("numba.core.registry.CPUDispatcher",),
    "granular/compiled/kernel_cache.py": (
        "numba.core.caching.NullCache",
        "numba.core.serialize.dumps",
        "numba.core.compiler.CompileResult._reduce",
        "numba.core.codegen.JITCodeLibrary.has_dynamic_globals",
        "numba._dynfunc.make_function",
        "numba.core.codegen.JITCodeLibrary._raise_if_finalized",
        "numba.core.codegen.JITCodeLibrary._finalize_dynamic_globals",
        "numba.core.codegen.JITCodeLibrary._ensure_finalized",
        "numba.core.codegen.JITCodeLibrary._get_module_for_linking",
        "numba.core.codegen.JITCodeLibrary.serialize_using_object_code",
        "numba.core.codegen.JITCodeLibrary.enable_object_caching",
        "numba.core.compiler.compile_result",
        "numba.core.compiler.Compiler.define_pipelines",
        "numba.core.compiler.Compiler._compile_core",
        "numba.core.compiler.CompileResult._rebuild",
    ),
    "granular/compiled/hook_calls.py": (
        "numba.core.cgutils.gep_inbounds",
        "numba.core.imputils.impl_ret_borrowed",
        "numba.core.typing.templates.infer_getattr",
        "numba.extending.lower_getattr_generic",
        "numba.extending.intrinsic",
        "numba.core.typing.context.BaseContext.resolve_value_type",
        "numba.core.base.BaseContext.get_function",
        "numba.core.base.BaseContext.add_linking_libs",
    ),
}
"""Internals by the file that uses them; `docs/reference/compiled.md` explains their use."""


@pytest.mark.parametrize(
    ("file", "name"), [(file, name) for file, names in INSIDES.items() for name in names]
)
def test_numba_has_the_internals_that_the_toolkit_uses(file: str, name: str) -> None:
    words = name.split(".")
    for length in range(len(words) - 1, 0, -1):
        try:
            found: Any = importlib.import_module(".".join(words[:length]))
        except ModuleNotFoundError:
            continue
        for word in words[length:]:
            found = getattr(found, word, None)
        break
    assert found is not None, (
        f"Numba {numba.__version__} has no {name}, which {file} builds on: see "
        "docs/reference/compiled.md and correct that file"
    )


PROGRAM = """
import sys
import numpy as np
from granular.compiled.trial_kernels import Weighted, _sum_by_compiled_kernel
print(_sum_by_compiled_kernel(Weighted(np.arange(4.0), 0.5)), "granular.compiled.kernel_cache" in sys.modules)
"""


def start(folder: Path, switch: str = "", tampering: str = "") -> tuple[list[str], list[str]]:
    """Modify Numba, run a compiled function in a new process, and return its output and messages."""
    (folder / "sitecustomize.py").write_text(tampering, encoding="utf-8")
    environment = {
        **os.environ,
        "GRANULAR_PLAIN_NUMBA": switch,
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]),
        "PYTHONWARNINGS": "",
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=environment
    )
    return done.stdout.split(), done.stderr.splitlines()


def files(folder: Path, pattern: str) -> dict[Path, int]:
    """Return cached files with their modification times [ns]."""
    return {path: path.stat().st_mtime_ns for path in (folder / "cache").rglob(pattern)}


@pytest.mark.parametrize(("switch", "linked", "kept"), [("1", "False", "*.nbc"), ("0", "True", "*.kernel")])
def test_compiled_functions_are_cached_with_and_without_separate_linking(
    switch: str, linked: str, kept: str, tmp_path: Path
) -> None:
    assert start(tmp_path, switch) == (["3.0", linked], [])
    kernels = files(tmp_path, kept)
    assert any("._sum_by_compiled_kernel-" in path.name for path in kernels)
    assert start(tmp_path, switch) == (["3.0", linked], [])
    assert files(tmp_path, kept) == kernels


def test_a_changed_function_is_recompiled_also_with_numbas_own_cache(
    fresh_workshop: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The changed function is called from another file."""
    monkeypatch.setenv("GRANULAR_PLAIN_NUMBA", "1")
    before = float(fresh_workshop.run()[0])
    kept = set(fresh_workshop.cache.rglob("*.nbc"))
    assert kept
    fresh_workshop.edit("effects/wall_laws.py", "STRENGTH * 3.5", "STRENGTH * 3.5 * 4.0")
    assert float(fresh_workshop.run()[0]) == pytest.approx(2.0 * before, rel=1e-12)
    # Code of former sources is taken out.
    now = set(fresh_workshop.cache.rglob("*.nbc"))
    assert now
    assert not now & kept


NEWER = "import numba; numba.__version__ = '9.9.9'\n"
SUBCLASS = """
import os
from numba.core.codegen import JITCodeLibrary

def refuse():
    raise TypeError("code libraries are closed")

JITCodeLibrary.__init_subclass__ = """


@pytest.mark.long  # quick: one that lacks them, and this one, whose version is known
def test_internals_of_a_newer_numba_are_used_if_they_are_compatible(tmp_path: Path) -> None:
    assert start(tmp_path, "", NEWER) == (["3.0", "True"], [])
    (verdict,) = files(tmp_path, "insides").items()
    assert start(tmp_path, "", NEWER) == (["3.0", "True"], [])
    assert files(tmp_path, "insides") == dict([verdict])
    assert start(tmp_path)[1] == []


@pytest.mark.parametrize(
    ("subclass", "fault"),
    [
        ("refuse", "(TypeError: code libraries are closed)"),
        pytest.param("os.abort", "(exit code -6)", marks=pytest.mark.long),
    ],
)
def test_plain_njit_is_used_if_numbas_internals_are_incompatible(
    subclass: str, fault: str, tmp_path: Path
) -> None:
    for _ in range(2):
        printed, said = start(tmp_path, "", NEWER + SUBCLASS + subclass)
        assert printed == ["3.0", "False"]
        (warning,) = [line for line in said if "Warning" in line]
        assert "numba 9.9.9 is outside the tested versions, 0.64 to 0.68" in warning
        assert fault in warning
    assert len(files(tmp_path, "insides")) == 1


def test_the_lowest_version_of_numba_that_pip_allows_is_the_lowest_tested_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required = [one for one in project["dependencies"] if one.startswith("numba")]
    assert required == ["numba>=" + ".".join(map(str, TESTED[0]))]
