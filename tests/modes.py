"""Mark for tests that are faster in plain Python than with compilation."""

from collections.abc import Callable
from typing import Any

import numba
import pytest


def quick_in_plain_python(test: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a test of few grains and steps as quick in plain Python, and as a long test of compiled code.

    `tests/architecture/test_plain_python.py` runs the marked tests.
    """
    marked = pytest.mark.plain(test)
    if not numba.config.DISABLE_JIT:
        return pytest.mark.long(marked)
    # Unlike Python, Numba returns infinity for a division by zero without a warning.
    return pytest.mark.filterwarnings("ignore::RuntimeWarning")(marked)
