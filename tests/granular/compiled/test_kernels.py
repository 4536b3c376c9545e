"""Calls of compiled functions and of force laws, and the digest of the sources of compiled functions."""

import ast
import functools
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from granular.compiled import compiled, entry
from granular.compiled.hook_calls import (
    make_hook_call_kernel,
    make_hook_maximum_kernel,
    make_hook_sum_kernel,
    make_last_hook_kernel,
)
from granular.compiled.numba_insides import (
    FOLDERS,
    PACKAGE,
    digest_of_code_without_comments,
    digest_of_file_contents,
    read_compiled_sources,
)
from granular.effects import drag, friction
from granular.kernel_data import state
from granular.pairs.direct_sum import reproducible_sum
from granular.schema import cell


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_calling_a_compiled_inner_function_from_python_is_an_error() -> None:
    with pytest.raises(
        TypeError, match=r"effects\.friction\.velocity_factor_after_friction can be called only by kernels"
    ):
        friction.velocity_factor_after_friction(1.0, 2.0)


def test_entry_wrapper_makes_a_compiled_function_callable_from_python() -> None:
    values = np.arange(16.0)
    assert entry(reproducible_sum)(values) == values.sum()
    assert entry(friction.velocity_factor_after_friction)(1.0, 2.0) == 0.0
    assert drag.exact_drag_step_factors(1.0, 0.0)[0] == 1.0  # is an entry, and a kernel for kernels


def test_compiled_functions_are_plain_python_if_compilation_is_switched_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)

    def double(x: float) -> float:
        return 2.0 * x

    assert compiled(double) is double
    assert compiled(inline=True)(double) is double
    assert entry(double) is double


def test_compiled_functions_of_other_packages_are_not_cached() -> None:
    """The digest that detects outdated cached code does not include the sources of other packages."""

    @entry
    def double(x: float) -> float:
        return 2.0 * x

    assert double(2.0) == 4.0
    assert getattr(getattr(double, "_cache", None), "cache_path", None) is None


class Quiet(NamedTuple):
    """Law whose function returns a constant, to which Numba gives a literal type."""

    size: float

    @staticmethod
    @numba.njit
    def act(law: Any, workspace: Any, place: int, values: Any) -> int:
        return 0

    @staticmethod
    @numba.njit
    def reach(law: Any, workspace: Any, place: int, at: float) -> float:
        return law.size * at


class Loud(NamedTuple):
    size: float
    values: np.ndarray

    @staticmethod
    @numba.njit
    def act(law: Any, workspace: Any, place: int, values: Any) -> int:
        values[0] = 10.0 * values[0] + place
        return 1 if values[0] > 0.0 else 0

    @staticmethod
    @numba.njit
    def reach(law: Any, workspace: Any, place: int, at: float) -> float:
        return law.size * at + workspace[0]


class Idle(NamedTuple):
    size: float


@numba.njit
def _silent(values: Any) -> int:
    return -1


@numba.njit
def _without(law: Any, at: float) -> int:
    return -1


LAWS = (Quiet(1.0), Loud(2.0, np.ones(2)), Idle(0.5), Loud(3.0, np.ones(3)))
WORKSPACES = (None, np.array([0.5]), None, np.array([7.0]))

forward, backward = (
    make_hook_sum_kernel("act", "values"),
    make_hook_sum_kernel("act", "values", backward=True),
)
greatest, last = make_hook_maximum_kernel("reach", "at"), make_last_hook_kernel("act", "values", _silent)
chosen = make_hook_call_kernel("nothing", "at", _without)


@entry
def every(laws: Any, workspaces: Any, values: Any) -> Any:
    return (
        forward(laws, workspaces, values),
        backward(laws, workspaces, values),
        greatest(laws, workspaces, 2.0),
        last(laws, workspaces, values),
        chosen(laws[0], 1.0),
    )


@pytest.mark.parametrize("places", [(0, 1, 2, 3), (1, 2), (2,)], ids=str)
def test_functions_of_several_laws_are_called_in_order_with_their_workspace_and_index(
    places: tuple[int, ...],
) -> None:
    laws, workspaces = (tuple(one[place] for place in places) for one in (LAWS, WORKSPACES))
    values = np.array([0.0])
    found = every(laws, workspaces, values)
    acting = [place for place, law in enumerate(laws) if isinstance(law, Loud)]
    digits, counts = 0.0, []
    for order in (acting, acting[::-1], acting[-1:]):
        count = 0
        for place in order:
            digits = 10.0 * digits + place
            count += digits > 0.0
        counts.append(count)
    reaches = [
        2.0 * law.size + (0.0 if workspace is None else workspace[0])
        for law, workspace in zip(laws, workspaces, strict=True)
        if not isinstance(law, Idle)
    ]
    assert values[0] == digits
    assert found == (*counts[:2], max(reaches, default=0.0), counts[2] if acting else -1, -1)


FILES = read_compiled_sources()
FEW = {
    name: content
    for name, content in FILES.items()
    if name.startswith("kernel_data/")
    or name in ("compiled/__init__.py", "effects/drag.py", "pairs/dipole_law.py")
    or name in ("pairs/direct_sum.py", "pairs/grain_arrays.py", "pairs/simd.py")
}
"""Files that import each other: parsing all takes half a second."""


@functools.cache
def digest(*, few: bool) -> str:
    return digest_of_code_without_comments(FEW if few else FILES)


def edited(name: str, old: str, new: str, files: dict[str, bytes]) -> dict[str, bytes]:
    assert old.encode() in files[name]
    return files | {name: files[name].replace(old.encode(), new.encode(), 1)}


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("effects/drag.py", '"""Viscous drag,', '"""Other words:'),
        ("effects/drag.py", "    z = rate * dt", "    # A comment.\n\n    z = (rate  * dt)"),
        (
            "pairs/dipole_law.py",
            '    """Return the repulsion',
            '    """More.\n\n    Lines.\n    """\n    """',
        ),
        ("pairs/dipole_law.py", "Coefficients", "The coefficients"),
        ("engine/state.py", "WRONG = 1e-2", "WRONG = 2e-2"),  # no kernel knows it
    ],
)
def test_digest_of_compiled_sources_ignores_docstrings_and_files_without_compiled_functions(
    name: str, old: str, new: str
) -> None:
    few = name in FEW
    files = edited(name, old, new, FEW if few else FILES)
    assert digest_of_code_without_comments(files) == digest(few=few)
    assert digest_of_file_contents(files) != digest_of_file_contents(FEW if few else FILES)


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
def test_digest_of_compiled_sources_depends_on_every_compiled_expression_and_constant(
    name: str, old: str, new: str
) -> None:
    assert digest_of_code_without_comments(edited(name, old, new, FEW)) != digest(few=True)


def test_compiled_files_import_constants_only_from_folders_included_in_the_digest() -> None:
    """The value of such a constant would be compiled in, and a later change would not be detected."""
    for name, content in FILES.items():
        for node in ast.walk(ast.parse(content)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("granular."):
                workspace = (node.module or "").split(".")[1]
                constants = [one.name for one in node.names if one.name.isupper()]
                assert workspace in FOLDERS or not constants, (name, node.module, constants)
    assert {path.name for path in PACKAGE.iterdir()} >= set(FOLDERS)


def test_compiled_functions_and_scenes_use_the_same_numbers_for_cell_and_piston() -> None:
    """The numbers are defined twice, since compiled files import nothing from the scene description."""
    assert (state.CELL, state.PISTON) == (cell.CELL, cell.PISTON)
