"""What kernels need of Numba's insides is there, and kernels do without most of it."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys

import numba
import pytest

INSIDES = {
    "granular/compiled/__init__.py": ("numba.core.compiler.Compiler", "numba.core.registry.CPUDispatcher"),
    "granular/compiled/kernel_cache.py": (
        "numba.core.caching._Cache",
        "numba.core.serialize.dumps",
        "numba.core.compiler.CompileResult._reduce",
        "numba.core.codegen.JITCodeLibrary.has_dynamic_globals",
    ),
    "granular/compiled/kernel_linking.py": (
        "numba._dynfunc.make_function",
        "numba.core.codegen.JITCodeLibrary._raise_if_finalized",
        "numba.core.codegen.JITCodeLibrary._finalize_dynamic_globals",
        "numba.core.codegen.JITCodeLibrary._ensure_finalized",
        "numba.core.codegen.JITCodeLibrary._get_module_for_linking",
        "numba.core.codegen.JITCodeLibrary.serialize_using_object_code",
        "numba.core.codegen.JITCodeLibrary.enable_object_caching",
        "numba.core.compiler.Compiler.define_pipelines",
        "numba.core.compiler.Compiler._compile_core",
        "numba.core.compiler.CompileResult._rebuild",
    ),
    "granular/compiled/by_reference.py": (
        "numba.core.cgutils.gep_inbounds",
        "numba.core.imputils.impl_ret_borrowed",
        "numba.core.typing.templates.infer_getattr",
        "numba.extending.lower_getattr_generic",
    ),
    "granular/compiled/hook_calls.py": (
        "numba.extending.intrinsic",
        "numba.core.typing.context.BaseContext.resolve_value_type",
        "numba.core.base.BaseContext.get_function",
        "numba.core.base.BaseContext.add_linking_libs",
    ),
}
"""By the file that takes them; `docs/reference/compiled.md` says what for."""


@pytest.mark.parametrize(
    ("file", "name"), [(file, name) for file, names in INSIDES.items() for name in names]
)
def test_numba_has_what_kernels_take(file: str, name: str) -> None:
    words = name.split(".")
    for length in range(len(words) - 1, 0, -1):
        try:
            found = importlib.import_module(".".join(words[:length]))
        except ModuleNotFoundError:
            continue
        for word in words[length:]:
            found = getattr(found, word, None)
        break
    assert found is not None, (
        f"Numba {numba.__version__} has no {name}, which {file} builds on: see "
        "docs/reference/compiled.md, correct that file, and until then set GRANULAR_PLAIN_NUMBA=1 "
        "or install an older Numba"
    )


PROGRAM = """
import sys
from typing import NamedTuple
import numpy as np
from granular.compiled import compiled, entry
from granular.compiled.by_reference import by_reference

class Pair(NamedTuple):
    values: np.ndarray
    factor: float

@compiled
def below(pair):
    return pair.factor * pair.values.sum()

@entry
def whole(pair):
    return below(by_reference(pair))

print(whole(Pair(np.arange(4.0), 0.5)), "granular.compiled.kernel_linking" in sys.modules)
"""


@pytest.mark.parametrize(("plain", "linked"), [("1", "False"), ("0", "True")])
def test_kernels_do_without_linking(plain: str, linked: str) -> None:
    environment = {**os.environ, "GRANULAR_PLAIN_NUMBA": plain}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.split() == ["3.0", linked]
