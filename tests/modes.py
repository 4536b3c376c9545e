"""Tests that compile nothing, for which plain Python is quicker than a compiler."""

from collections.abc import Callable
from typing import Any

import numba
import pytest


def quick_in_plain_python(test: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a test of few grains and steps: quick in plain Python, and a long one where it is compiled.

    `tests/architecture/test_plain_python.py` runs them.
    """
    marked = pytest.mark.plain(test)
    if not numba.config.DISABLE_JIT:
        return pytest.mark.long(marked)
    # Numba answers a division by zero with infinity and does not warn of it, as Python does.
    return pytest.mark.filterwarnings("ignore::RuntimeWarning")(marked)
