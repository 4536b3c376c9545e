"""Kernels that the types of laws choose when the loop is compiled.

An effect gives the loop its *law*: a named tuple of numbers and arrays, whose class has the
effect's kernels as static methods, by the names of the loop's *hooks*. The laws that act are a
tuple; what is made here calls a hook of each of them, one after another, as if the calls stood in
the source. A law without the hook leaves nothing in the code. Without the compiler the same is
chosen at every call.
"""

from __future__ import annotations

import functools
import inspect
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba
from llvmlite import ir
from numba import types
from numba.core.typing import Signature, signature
from numba.extending import intrinsic

Kernel = Callable[..., Any]

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "forceinline": True}
"""Options for a user's functions: those of `granular.compiled.compiled` with ``inline``."""


def sum_of_hooks(hook: str, rest: str, empty: float = 0, *, backward: bool = False) -> Kernel:
    """Make a kernel ``(laws, workspaces, *rest)`` that adds up what a hook of each law returns."""
    return _call_hooks(hook, rest, slice(None, None, -1 if backward else 1), empty)


def greatest_of_hooks(hook: str, rest: str) -> Kernel:
    """Make a kernel as of `sum_of_hooks`, for the greatest value; 0 where no law has the hook."""
    return _call_hooks(hook, rest, slice(None), 0.0, max, _emit_maximum)


def call_last_hook(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel that calls the hook of the last law that has it; without one ``otherwise(*rest)``."""
    return _call_hooks(hook, rest, slice(-1, None), otherwise=otherwise)


def _call_hooks(
    hook: str,
    rest: str,
    called: slice,
    empty: float = 0,
    join: Kernel = operator.add,
    emit_join: Kernel | None = None,
    otherwise: Kernel | None = None,
) -> Kernel:
    """Make a kernel that calls a hook of some of the laws that have it, and joins what they return."""

    def call(laws: Any, workspaces: Any, *others: Any) -> Any:
        indices = [index for index, law in enumerate(laws) if hasattr(law, hook)][called]
        if not indices:
            return empty if otherwise is None else otherwise(*others)
        results = (getattr(laws[k], hook)(laws[k], workspaces[k], k, *others) for k in indices)
        return functools.reduce(join, results)

    def choose(context: Any, laws: Any, workspaces: Any, *others: Any) -> tuple[Signature, Kernel]:
        indices = [index for index, law in enumerate(laws.types) if hasattr(law.instance_class, hook)]
        calls = [
            _resolve_hook_call(context, hook, laws, workspaces, index, others) for index in indices[called]
        ]
        if not calls and otherwise is not None:
            calls = [_resolve_kernel_call(context, otherwise, others, lambda *given: given[2][2:])]
        return _emit_unrolled_calls(calls, empty, emit_join or _emit_sum, (laws, workspaces, *others))

    return _make_intrinsic_wrapper(call, choose, f"laws workspaces {rest}")


def call_hook(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel ``(law, *rest)`` that calls a law's hook; ``otherwise`` of a law without it, or None."""

    def call(law: Any, *others: Any) -> Any:
        return getattr(law, hook, otherwise)(law, *others)

    def choose(context: Any, law: Any, *others: Any) -> tuple[Signature, Kernel]:
        kernel = getattr(getattr(law, "instance_class", None), hook, otherwise)
        call_law = _resolve_kernel_call(context, kernel, (law, *others), lambda *given: given[2])
        return _emit_unrolled_calls([call_law], 0, _emit_sum, (law, *others))

    return _make_intrinsic_wrapper(call, choose, f"law {rest}")


class _KernelCall(NamedTuple):
    """A call of a kernel in compiled code."""

    kernel: Any
    sig: Signature
    given: Sequence[Any]  # types of its arguments
    take: Kernel  # (context, builder, values) -> arguments, of those of the calling kernel


def _resolve_kernel_call(context: Any, kernel: Kernel, given: Sequence[Any], take: Kernel) -> _KernelCall:
    known = context.resolve_value_type(kernel)
    return _KernelCall(known, known.get_call_type(context, tuple(given), {}), given, take)


def _resolve_hook_call(
    context: Any, hook: str, laws: Any, workspaces: Any, index: int, rest: Sequence[Any]
) -> _KernelCall:
    def take(context: Any, builder: Any, values: Sequence[Any]) -> list[Any]:
        own = [builder.extract_value(value, index) for value in values[:2]]
        return [*own, context.get_constant(types.int64, index), *values[2:]]

    kernel = getattr(laws.types[index].instance_class, hook)
    given = (laws.types[index], workspaces.types[index], types.int64, *rest)
    return _resolve_kernel_call(context, kernel, given, take)


def _emit_sum(builder: Any, first: Any, second: Any) -> Any:
    """Sum of two numbers of one type."""
    is_integer = isinstance(first.type, ir.IntType)
    return builder.add(first, second) if is_integer else builder.fadd(first, second)


def _emit_maximum(builder: Any, first: Any, second: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", first, second), first, second)


def _emit_unrolled_calls(
    calls: Sequence[_KernelCall], empty: float, join: Kernel, given: tuple[Any, ...]
) -> tuple[Signature, Kernel]:
    """Return the calls, one after another, and what joins their results."""
    none = types.float64 if isinstance(empty, float) else types.int64
    # Not a literal: the sum of what two calls return is not what the first one always does.
    result = types.unliteral(calls[0].sig.return_type) if calls else none

    def write(context: Any, builder: Any, sig: Signature, values: Sequence[Any]) -> Any:
        if not calls:
            return context.get_constant(none, empty)
        total = None
        for call in calls:
            output = _emit_call(context, builder, call, values)
            if result == types.none:
                total = context.get_dummy_value()
            else:
                output = context.cast(builder, output, call.sig.return_type, result)
                total = output if total is None else join(builder, total, output)
        return total

    return signature(result, *given), write


def _emit_call(context: Any, builder: Any, call: _KernelCall, values: Sequence[Any]) -> Any:
    arguments = [
        context.cast(builder, value, have, want)
        for value, have, want in zip(
            call.take(context, builder, values), call.given, call.sig.args, strict=True
        )
    ]
    function = context.get_function(call.kernel, call.sig)
    context.add_linking_libs(getattr(function, "libs", ()))
    return function(builder, arguments)


def _make_intrinsic_wrapper(call: Kernel, choose: Any, names: str) -> Kernel:
    """Return a function that plain Python or kernels call, with arguments of these names."""
    if numba.config.DISABLE_JIT:
        return call
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    given = [inspect.Parameter(name, kind) for name in ("context", *names.split())]
    choose.__signature__ = inspect.Signature(given)
    return intrinsic(choose)
