"""Functions of an own effect, and the type by which their digest identifies its compiled code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

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


def user_code_error(definition: CustomDefinition, what: str, error: BaseException) -> InputError:
    """Make the error of a user's code, in one line."""
    return InputError(
        f"{definition.display_name}: {what}: {type(error).__name__}: {one_line(error)}; correct it"
    )
