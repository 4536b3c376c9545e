"""Separation of tests in plain Python, without numba's compilation, from tests of compiled code."""

from pathlib import Path

import numba
import pytest

COMPILED = {"test_compiled.py"}
IN_BOUNDS = {"test_memory_bounds.py"}
"""Also run compiled, with checks of indices."""


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Ignore the files for the other mode, since numba either compiles or not in a whole process."""
    if not collection_path.name.startswith("test_"):
        return None
    if numba.config.DISABLE_JIT:
        return collection_path.name in COMPILED or None
    return (
        collection_path.name not in (COMPILED | IN_BOUNDS if numba.config.BOUNDSCHECK else COMPILED) or None
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Ignore warnings of inaccuracy in runs of a few steps."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.plain)
            item.add_marker(pytest.mark.filterwarnings("ignore:two grains came as close"))
            item.add_marker(pytest.mark.filterwarnings("ignore:the energy balance"))
