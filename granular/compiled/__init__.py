"""The one place where kernels are compiled: cached on disk, strict in arithmetic, without the GIL.

`compiled` makes a kernel that other kernels call, `entry` one that Python calls. What Python needs
to call a kernel takes about a sixth of the time of compiling it, so most kernels have none of it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar, overload

import numba
import numpy as np
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

from granular.compiled.numba_insides import PACKAGE, insides_are_usable

_INNER: dict[str, Any] = {}
_ENTRY: dict[str, Any] = {}
if insides_are_usable():
    from granular.compiled.kernel_cache import EntryCompiler, InnerCompiler, cache_kernel

    _INNER, _ENTRY = {"pipeline_class": InnerCompiler}, {"pipeline_class": EntryCompiler}
else:
    from granular.compiled.numba_insides import cache_kernel_by_numba as cache_kernel

__all__ = ["Array", "compiled", "entry"]

Array = NDArray[np.float64]

F = TypeVar("F", bound=Callable[..., Any])


class InnerKernel(CPUDispatcher):
    """A kernel that only kernels can call: without what Python needs, a call of it would crash."""

    def __call__(self, *args: object, **kwargs: object) -> NoReturn:
        raise TypeError(
            f"{self.py_func.__module__}.{self.py_func.__qualname__} is a kernel for other kernels; "
            "declare it with @entry, or call entry(...) of it, to call it from Python"
        )


@overload
def compiled(function: F) -> F: ...
@overload
def compiled(*, parallel: bool = ..., inline: bool = ...) -> Callable[[F], F]: ...
def compiled(function: Any = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """Compile a kernel that other kernels call.

    No operation is reordered or fused with another, so a result depends neither on the number of
    threads, nor on what is recorded, nor on the order in which kernels are put into their callers.

    Parameters
    ----------
    function : function, optional
        Kernel; without one a decorator is returned.
    parallel : bool
        Run its ``prange`` loops on Numba's threads.
    inline : bool
        Put the code into every caller, for what is met at every step and is short.

    Returns
    -------
    function
        Compiled kernel, or a decorator.

    Raises
    ------
    TypeError
        If Python calls it.
    """
    if function is None:
        return functools.partial(compiled, parallel=parallel, inline=inline)
    bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    # Code on threads is reached by its address, so it stands by itself.
    pipeline = {} if parallel else _INNER
    kernel = _compile_kernel(function, parallel=parallel, forceinline=inline, **bare, **pipeline)
    if isinstance(kernel, CPUDispatcher):  # a plain function where compiling is switched off
        kernel.__class__ = InnerKernel
    return kernel


def threaded_if_wanted(loop: Callable[..., Any]) -> Callable[..., Any]:
    """Kernel ``(threaded, *rest)`` of one with a ``prange`` loop: on Numba's threads, or on one for None."""
    serial, parallel = compiled(loop), compiled(parallel=True)(loop)

    def run(threaded: bool | None, *rest: Any) -> Any:
        return serial(*rest) if threaded is None else parallel(*rest)

    # Compiled forms are kept by their names.
    run.__module__, run.__qualname__ = loop.__module__, f"{loop.__qualname__}.run"
    return compiled(run)


def entry(function: F) -> F:
    """Compile a kernel that Python calls, and other kernels may.

    Parameters
    ----------
    function : function
        Function, or a kernel of `compiled`, for another form of it that Python can call.

    Returns
    -------
    function
        Compiled function.
    """
    plain = getattr(function, "py_func", function)
    return _compile_kernel(plain, no_cfunc_wrapper=True, **_ENTRY)


def _compile_kernel(function: Any, **options: Any) -> Any:
    # No ``fastmath``: with reordered sums one thread and several would not have the same bits, and
    # compensated sums would be lost; a b + c in one rounding would depend on the order of inlining.
    kernel = numba.njit(error_model="numpy", nogil=True, **options)(function)
    # What stands elsewhere is not in the digest of the sources, and is compiled in every process.
    if isinstance(kernel, CPUDispatcher) and function.__module__.startswith(f"{PACKAGE.name}."):
        cache_kernel(kernel)
    return kernel
