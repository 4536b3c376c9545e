"""An effect of a user's own: a class with a few static functions, decorated with `effect`.

    from granular import effect, quantity

    @effect
    class Spring:
        \"\"\"A spring that pulls every grain towards a height.\"\"\"

        k: float = quantity("N/m", above=0.0)
        height: float = quantity("m", default=0.0)

        @staticmethod
        def energy(p, grain, time):
            return 0.5 * p.k * (grain.y - p.height) ** 2

        @staticmethod
        def force(p, grain, time):
            return 0.0, -p.k * (grain.y - p.height)

        @staticmethod
        def stiffness(p, grain, time):
            return p.k

From then on a scene may say ``effects.spring = { k = "10 N/m" }``, with units, limits and checks.
The functions are compiled into the loop, so they hold what Numba compiles: arithmetic, `math`, and
functions that are compiled themselves. They see the parameters ``p`` and a ``grain`` with its
``x``, ``y``, ``mass`` and ``moment``, in natural units, in which any formula with consistent units
reads as it does in SI. There may be, each with what belongs to it:

``energy(p, grain, time)``, ``force(p, grain, time) -> (fx, fy)``
    Of a grain; the force is minus the gradient of the energy.
``stiffness(p, grain, time)``
    A bound of the force's slope, which the automatic step follows.
``power(p, grain, time)``
    d(energy)/d(time) at a fixed place, where the energy depends on time: work from outside.
``flow(p, grain, vx, vy, span) -> (vx, vy)``
    Velocity after ``span`` under a dissipative effect alone, exactly, for either sign of ``span``.
    What it takes is entered in the ledger.
``pair_energy(p, r, first, second)``, ``pair_force(p, r, first, second)``
    Of two grains at the distance r; the force is positive where they repel each other.
``pair_stiffness(p, r, first, second)``
    A bound of its slope.
``reach(p)``
    Distance from which on a pair does nothing; all pairs count without it.
``frequency(p)``
    Highest angular frequency with which it changes in time, for the step.

What is not there costs nothing. Compiled code is kept under a digest of the functions and of all
that they use of their file, so a second process starts as fast as with a built-in effect, and an
edited one is compiled anew.
"""

from __future__ import annotations

import collections
import dataclasses
import math
import types as python_types
from collections.abc import Callable
from typing import Any, ClassVar

import numba
import numpy as np

from granular.compiled.dispatch import OPTIONS
from granular.effects.effect import Effect, Setting, in_joules
from granular.effects.own_check import check, check_compiling
from granular.effects.own_definition import (
    DEFINITIONS,
    FUNCTIONS,
    Definition,
    Kind,
    functions_digest,
)
from granular.effects.own_law import OwnLaw
from granular.effects.registry import register
from granular.pairs.direct import padded_values
from granular.scene.scales import Scales
from granular.scene.schema import Quantity, Whole, unknown
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.shared.own_files import module_of


class OwnEffect(Effect):
    """Base of the effects that `effect` makes."""

    rank = 1
    definition: ClassVar[Definition]
    written: ClassVar[type]
    origin: ClassVar[tuple[str, str] | None] = None

    def law(self, setting: Setting) -> OwnLaw:
        """The law in natural units.

        Raises
        ------
        InputError
            If a function fails, or a force is not the gradient of its energy.
        """
        p = self.natural(setting.scales)
        check(self.definition, p, setting)
        return self.law_of(self.definition, p, None)

    def check_compiling(self, setting: Setting) -> None:
        check_compiling(self.definition, self.natural(setting.scales))

    @staticmethod
    def law_of(definition: Definition, p: Any, factor: np.ndarray | None) -> OwnLaw:
        """The law of a definition with these parameters."""
        reach = definition.functions.get("reach")
        DEFINITIONS[definition.digest] = definition
        return OwnLaw(
            Kind(definition.digest),
            tuple(p),
            math.inf if reach is None else float(reach(p)),
            None if factor is None else padded_values(factor),
        )

    def natural(self, scales: Scales) -> Any:
        """The parameters in natural units."""
        return self.definition.parameters(
            *(
                float(getattr(self, field.name)) / scales.unit(_unit(field.metadata["kind"]))
                for field in dataclasses.fields(self)
            )
        )

    @property
    def sources(self) -> tuple[str, ...]:
        """Digests of what it is made of, for the run's settings."""
        return (self.definition.digest,)

    @property
    def is_flow(self) -> bool:
        return "flow" in self.definition.functions

    def drive_frequency(self, scales: Scales) -> float:
        found = self.definition.functions.get("frequency")
        return 0.0 if found is None else abs(float(found(self.natural(scales))))

    def __reduce__(self) -> Any:
        """Any process can have it so: with the file's text, or with the class as it was written."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return rebuilt, (self.key, self.origin, None if self.origin else self.written, values)


def rebuilt(key: str, origin: tuple[str, str] | None, written: Any, values: Any) -> OwnEffect:
    """An own effect in another process."""
    found = effect(written) if origin is None else effects_of(*origin)[key]
    one: OwnEffect = found(**values)
    return one


def _unit(kind: Any) -> str:
    return kind.unit if isinstance(kind, Quantity) else "1"


def effect(written: type) -> Any:
    """Make a class an effect that scenes can name; see the head of this file.

    Parameters
    ----------
    written : type
        A class with parameters (`quantity`) and static functions. Its name in small letters is what
        a scene calls it: ``LeafSpring`` is ``leaf_spring``.

    Raises
    ------
    InputError
        If the class is no such.
    """
    key = "".join(f"_{one.lower()}" if one.isupper() else one for one in written.__name__)
    key = key.lstrip("_")
    content = {
        name: value for name, value in vars(written).items()
        if name not in ("__dict__", "__weakref__")
    }  # fmt: skip
    functions = {
        name: value.__func__ for name, value in content.items() if isinstance(value, staticmethod)
    }
    _check_functions(key, content, functions)
    fields = [name for name in content.get("__annotations__", {}) if name not in functions]
    digest = f"{key}_{functions_digest(functions, fields)}"
    definition = Definition(
        key, digest, collections.namedtuple("Parameters", fields), functions,  # type: ignore[misc]
        {name: _kernel(function) for name, function in functions.items()},
    )  # fmt: skip
    meaning = (written.__doc__ or key).strip().splitlines()[0].rstrip(".")
    for name in functions:
        del content[name]
    has_energy = "energy" in functions or "pair_energy" in functions
    energy = in_joules(f"{key}_energy", f"energy of: {meaning}") if has_energy else None
    loss = in_joules(f"{key}_loss", f"lost to: {meaning}") if "flow" in functions else None
    content |= {
        "key": key,
        "definition": definition,
        "written": written,
        "example": content.get("example", True),
        "damps": "flow" in functions,
        "energy_record": energy,
        "loss_record": loss,
    }  # fmt: skip
    made = type(written.__name__, (OwnEffect,), content)
    for field in dataclasses.fields(made):
        if not isinstance(field.metadata.get("kind"), Quantity | Whole):
            raise InputError(f"effect {key!r}: {field.name} must be a number; give quantity(unit)")
    register(made)
    return made


def _kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    return numba.njit(**OPTIONS)(function)  # type: ignore[no-any-return]


_NEED = {
    "force": "energy", "energy": "force", "stiffness": "energy", "power": "energy",
    "pair_force": "pair_energy", "pair_energy": "pair_force", "pair_stiffness": "pair_energy",
    "reach": "pair_energy",
}  # fmt: skip


def _check_functions(key: str, content: dict[str, Any], functions: dict[str, Any]) -> None:
    if not set(functions) & {"force", "flow", "pair_force"}:
        raise InputError(
            f"effect {key!r} does nothing; give it a static method 'force', 'pair_force' or 'flow'"
        )
    for name in functions:
        if name not in FUNCTIONS:
            raise InputError(f"effect {key!r}: {unknown(name, FUNCTIONS, 'function')}")
        if name in _NEED and _NEED[name] not in functions:
            raise InputError(
                f"effect {key!r} has {name!r} and no {_NEED[name]!r}; give it, as a static method"
            )
    for name, value in content.items():
        if not name.startswith("_") and name not in functions and hasattr(OwnEffect, name):
            raise InputError(f"effect {key!r}: {quoted(name)} has a meaning of its own; rename it")
        if isinstance(value, python_types.FunctionType):
            raise InputError(f"effect {key!r}: {name!r} must be static; write @staticmethod above")


def effects_of(file: str, text: str) -> dict[str, type[OwnEffect]]:
    """The effects that a user's file defines, by their names; the file is run once.

    Raises whatever the file raises.
    """
    module = module_of(file, text)
    found = {}
    for one in vars(module).values():
        if (
            isinstance(one, type)
            and issubclass(one, OwnEffect)
            and one.__module__ == module.__name__
        ):
            one.origin = (file, text)
            found[one.key] = one
    return found
