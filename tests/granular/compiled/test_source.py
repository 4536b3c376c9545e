"""What the digest of the kernels' sources sees: their syntax, and no texts."""

import ast
import functools

import pytest

from granular.compiled.numba_insides import (
    FOLDERS,
    PACKAGE,
    digest_of_bytes,
    digest_of_syntax,
    read_compiled_sources,
)
from granular.kernel_data import state
from granular.schema import cell

FILES = read_compiled_sources()
FEW = {
    name: content
    for name, content in FILES.items()
    if name.startswith("kernel_data/")
    or name in ("compiled/__init__.py", "effects/drag.py", "pairs/dipole_law.py")
    or name in ("pairs/direct_sum.py", "pairs/grain_arrays.py", "pairs/simd.py")
}
"""Files that import from each other: parsing all takes half a second."""


@functools.cache
def digest(*, few: bool) -> str:
    return digest_of_syntax(FEW if few else FILES)


def edited(name: str, old: str, new: str, files: dict[str, bytes]) -> dict[str, bytes]:
    assert old.encode() in files[name]
    return files | {name: files[name].replace(old.encode(), new.encode(), 1)}


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("effects/drag.py", '"""Viscous drag,', '"""Other words:'),
        ("effects/drag.py", "    z = rate * dt", "    # A comment.\n\n    z = (rate  * dt)"),
        ("pairs/dipole_law.py", '    """Repulsion', '    """More.\n\n    Lines.\n    """\n    """Repulsion'),
        ("pairs/dipole_law.py", "Coefficients", "The coefficients"),
        ("engine/state.py", "WRONG = 1e-2", "WRONG = 2e-2"),  # no kernel knows it
    ],
)
def test_texts_and_files_without_kernels_change_nothing(name: str, old: str, new: str) -> None:
    few = name in FEW
    files = edited(name, old, new, FEW if few else FILES)
    assert digest_of_syntax(files) == digest(few=few)
    assert digest_of_bytes(files) != digest_of_bytes(FEW if few else FILES)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("effects/drag.py", "z = rate * dt", "z = rate + dt"),
        ("pairs/dipole_law.py", "STRENGTH = 0.75", "STRENGTH = 0.76"),
        ("pairs/dipole_law.py", "CUBE = (6.5625", "CUBE = (6.5626"),  # a constant of kernels elsewhere
        ("kernel_data/state.py", "    vx: Float", "    vz: Float"),
        ("pairs/simd.py", "WIDTH = 8", "WIDTH = 4"),
        ("compiled/__init__.py", 'error_model="numpy"', 'error_model="python"'),
    ],
)
def test_what_the_compiler_sees_counts(name: str, old: str, new: str) -> None:
    assert digest_of_syntax(edited(name, old, new, FEW)) != digest(few=True)


def test_kernels_take_nothing_from_other_rooms_but_classes_and_functions() -> None:
    """A number from elsewhere would be compiled in, and its change would not be noticed."""
    for name, content in FILES.items():
        for node in ast.walk(ast.parse(content)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("granular."):
                workspace = (node.module or "").split(".")[1]
                constants = [one.name for one in node.names if one.name.isupper()]
                assert workspace in FOLDERS or not constants, (name, node.module, constants)
    assert {path.name for path in PACKAGE.iterdir()} >= set(FOLDERS)


def test_kernels_count_bodies_as_scenes_do() -> None:
    """The numbers stand in both rooms, since kernels take none from the scene's."""
    assert (state.CELL, state.PISTON) == (cell.CELL, cell.PISTON)
