"""Arithmetic in plain Python, which raises where compiled code goes on with what is not finite."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import numba

from granular.shared.errors import InputError


@contextlib.contextmanager
def unfinite_as(failure: Callable[[], Exception]) -> Iterator[None]:
    """Without the compiler, let arithmetic that fails in a kernel be what compiled code reports."""
    try:
        yield
    except (ArithmeticError, ValueError) as error:
        if not numba.config.DISABLE_JIT or isinstance(error, InputError):
            raise
        raise failure() from error
