"""Functions of an own effect, and the digest that identifies its compiled code."""

from __future__ import annotations

import hashlib
import types as python_types
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

from granular.shared.errors import InputError
from granular.shared.message_text import one_line

FUNCTIONS = (
    "energy",
    "force",
    "stiffness",
    "power",
    "flow",
    "pair_energy",
    "pair_force",
    "pair_stiffness",
    "reach",
    "frequency",
)
"""Names of the functions that an effect may have."""

WALL_FUNCTIONS = ("energy", "force", "stiffness")
"""Names of the functions that a law of a wall has."""


class Grain(NamedTuple):
    """A grain as the functions of an own effect see it."""

    x: float
    y: float
    mass: float
    moment: float


class CustomDefinition(NamedTuple):
    """Definition of an own effect, or of an own law of a wall."""

    what: str
    key: str
    digest: str
    parameters: Any
    functions: Mapping[str, Callable[..., Any]]
    kernels: Mapping[str, Callable[..., Any]]

    @property
    def display_name(self) -> str:
        """Name in messages."""
        return f"{self.what} {self.key!r}"


DEFINITIONS: dict[str, CustomDefinition] = {}
"""Definitions by their digests."""


class CustomLawKind:
    """An own effect in the type of its law: the digest is the name of the type."""

    def __init__(self, name: str) -> None:
        self.name = name


class CustomLawType(types.Dummy):  # type: ignore[misc]  # Numba is not typed
    """Numba's type of a `CustomLawKind`."""


@typeof_impl.register(CustomLawKind)
def _numba_type_of_kind(kind: CustomLawKind, context: Any) -> CustomLawType:
    return CustomLawType(kind.name)


register_model(CustomLawType)(models.OpaqueModel)


@unbox(CustomLawType)
def _unbox_kind(kind: Any, value: Any, context: Any) -> NativeValue:
    return NativeValue(context.context.get_dummy_value())


def functions_digest(functions: dict[str, Any], fields: list[str]) -> str:
    """Digest of functions, and of all that they use of their file."""
    digest, seen = hashlib.sha256(repr(fields).encode()), set[int]()
    for name in sorted(functions):
        digest.update(f"\0{name}\0".encode())
        for part in _iterate_code_and_values(functions[name], seen):
            digest.update(f"{part}\0".encode())
    return digest.hexdigest()[:24]


def _iterate_code_and_values(function: Any, seen: set[int]) -> Iterator[str]:
    """Yield the code of a function, and the values and functions that it names."""
    function = getattr(function, "py_func", function)
    if id(function) in seen:
        return
    seen.add(id(function))
    if not isinstance(function, python_types.FunctionType):
        # Of modules and of their functions the version counts, which is in the kernels' digest.
        yield f"{getattr(function, '__module__', '')}.{getattr(function, '__name__', '')}"
        return
    yield repr(function.__defaults__)
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    for used in cells:
        yield from _iterate_code_and_values(used, seen) if callable(used) else (repr(used),)
    yield from _iterate_code_constants(function.__code__, function.__globals__, seen)


def _iterate_code_constants(code: Any, names: dict[str, Any], seen: set[int]) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames))
    for value in code.co_consts:
        if isinstance(value, python_types.CodeType):
            yield from _iterate_code_constants(value, names, seen)
        else:
            yield repr(value)
    for name in code.co_names:
        used = names.get(name)
        if isinstance(used, python_types.ModuleType):
            yield used.__name__
        elif callable(used):
            yield from _iterate_code_and_values(used, seen)
        elif used is not None:
            yield repr(used.tolist() if isinstance(used, np.ndarray) else used)


def user_code_error(definition: CustomDefinition, what: str, error: BaseException) -> InputError:
    """Make the error of a user's code, in one line."""
    return InputError(
        f"{definition.display_name}: {what}: {type(error).__name__}: {one_line(error)}; correct it"
    )
