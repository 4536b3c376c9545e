"""Compilation of kernels by Numba: cached on disk, without reordered arithmetic, without the GIL.

A kernel is a function that Numba compiles. `compiled` makes kernels that only other kernels can call; `entry`
makes kernels that Python can call too. Most kernels are of the first kind, because the wrapper for calls from
Python takes about a sixth of the compile time.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar, overload

import numba
import numpy as np
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

from granular.compiled.numba_insides import PACKAGE, numba_internals_are_usable

_INNER: dict[str, Any] = {}
_ENTRY: dict[str, Any] = {}
if numba_internals_are_usable():
    from granular.compiled.kernel_cache import EntryCompiler, InnerCompiler, cache_kernel

    _INNER, _ENTRY = {"pipeline_class": InnerCompiler}, {"pipeline_class": EntryCompiler}
else:
    from granular.compiled.numba_insides import cache_kernel_by_numba as cache_kernel

__all__ = ["Array", "compiled", "entry"]

Array = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., Any])


class InnerKernel(CPUDispatcher):
    """Kernel without a Python wrapper, which only kernels can call; a call from Python raises TypeError."""

    def __call__(self, *args: object, **kwargs: object) -> NoReturn:
        raise TypeError(
            f"{self.py_func.__module__}.{self.py_func.__qualname__} can be called only by kernels; "
            "declare it with @entry, or pass it to entry(...), to call it from Python"
        )


@overload
def compiled(function: F) -> F: ...
@overload
def compiled(*, parallel: bool = ..., inline: bool = ...) -> Callable[[F], F]: ...
def compiled(function: Any = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """Compile a kernel for calls from other kernels.

    No operations are reordered or fused, so results depend neither on the number of threads, nor on the
    recorded quantities, nor on the order of inlining.

    Parameters
    ----------
    function : function, optional
        Function to compile; if not given, a decorator is returned.
    parallel : bool
        Whether ``prange`` loops of the function run on several threads.
    inline : bool
        Whether the code is inlined into every caller; suitable for short code that runs at every step.

    Returns
    -------
    function
        Compiled kernel, or a decorator.

    Raises
    ------
    TypeError
        If Python calls the compiled function.
    """
    if function is None:
        return functools.partial(compiled, parallel=parallel, inline=inline)
    bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    # Threaded code is called by its address, so it cannot be linked into its callers.
    pipeline = {} if parallel else _INNER
    kernel = _compile_kernel(function, parallel=parallel, forceinline=inline, **bare, **pipeline)
    if isinstance(kernel, CPUDispatcher):  # a plain function if compilation is disabled
        kernel.__class__ = InnerKernel
    return kernel


def make_optionally_threaded_kernel(loop: Callable[..., Any]) -> Callable[..., Any]:
    """Make a kernel ``(threaded, *rest)`` of a ``prange`` loop, with one thread if ``threaded`` is None."""
    serial, parallel = compiled(loop), compiled(parallel=True)(loop)

    def run(threaded: bool | None, *rest: Any) -> Any:
        return serial(*rest) if threaded is None else parallel(*rest)

    # Compiled code is cached by name.
    run.__module__, run.__qualname__ = loop.__module__, f"{loop.__qualname__}.run"
    return compiled(run)


def entry(function: F) -> F:
    """Compile a kernel for calls from Python and from other kernels.

    Parameters
    ----------
    function : function
        Function, or a kernel made by `compiled`.

    Returns
    -------
    function
        Compiled function that Python and kernels can call.
    """
    plain = getattr(function, "py_func", function)
    return _compile_kernel(plain, no_cfunc_wrapper=True, **_ENTRY)


def _compile_kernel(function: Any, **options: Any) -> Any:
    # No ``fastmath``: reordered sums would depend on the number of threads and break compensated sums;
    # fused a b + c would depend on the order of inlining.
    kernel = numba.njit(error_model="numpy", nogil=True, **options)(function)
    # Functions of other packages are not in the digest of the sources, and are compiled in every process.
    if isinstance(kernel, CPUDispatcher) and function.__module__.startswith(f"{PACKAGE.name}."):
        cache_kernel(kernel)
    return kernel
