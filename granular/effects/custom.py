"""Effects and laws of walls of a user's own: classes with static functions, and a decorator.

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
    d(energy)/d(time) at a fixed position, where the energy depends on time: work from outside.
``flow(p, grain, vx, vy, dt) -> (vx, vy)``
    Velocity after ``dt`` under a dissipative effect alone, exactly, for either sign of ``dt``.
    What it takes is entered in the ledger.
``pair_energy(p, r, first, second)``, ``pair_force(p, r, first, second)``
    Of two grains at the distance r; the force is positive where they repel each other.
``pair_stiffness(p, r, first, second)``
    A bound of its slope.
``reach(p)``
    Distance from which on a pair does nothing; all pairs count without it.
``frequency(p)``
    Highest angular frequency with which it changes in time, for the step.

A law of a wall is decorated with `wall_law` and has, of a grain of the first species at the
distance w (others feel it in the ratio of their moments):

``energy(p, w)``, ``force(p, w)``, ``stiffness(p, w)``
    Force away from the wall, minus the slope of the energy; and minus its own slope.

A scene names it as ``effects.walls.left = { law = "soft", k = "9 N/m", reach = "1 cm" }``. Either
can be a formula as well: `granular.effects.formula_fields`, `granular.effects.formula_pair_laws`,
and of the distance ``w`` of a wall:
``effects.walls.left = { energy = "a*(l/w)**3", a = "1 uJ", l = "6 mm" }``.

What is not there costs nothing. Compiled code is kept under a digest of the functions and of all
that they use of their file, so a second process starts as fast as with a built-in effect, and an
edited one is compiled anew.
"""

from __future__ import annotations

import collections
import dataclasses
import math
import types as python_types
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numba

from granular.compiled.hook_calls import OPTIONS
from granular.effects.custom_function_checks import (
    check_effect_functions,
    check_functions_compile,
    check_wall_functions,
)
from granular.effects.custom_functions import (
    DEFINITIONS,
    FUNCTIONS,
    WALL_FUNCTIONS,
    CustomDefinition,
    CustomLawKind,
)
from granular.effects.custom_law import CustomLaw, CustomWallLaw
from granular.effects.dissipative_effect import DissipativeEffect
from granular.effects.effect import EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.registry import WALL_LAWS, register_effect
from granular.schema.field_kinds import IntegerKind, QuantityKind, unknown_word_message
from granular.schema.natural_units import Scales
from granular.schema.sections import Section
from granular.shared.errors import InputError
from granular.shared.function_digest import functions_digest
from granular.shared.message_text import quote
from granular.shared.user_file import UserFile, user_definitions


class CustomSection(Section):
    """Base of what is made of a user's class.

    Attributes
    ----------
    definition : CustomDefinition
    user_class : type
        The class as it was written.
    origin : UserFile or None
        The file that it came from, where the command line named one.
    made_by : function
        The decorator.
    """

    definition: ClassVar[CustomDefinition]
    user_class: ClassVar[type]
    origin: ClassVar[UserFile | None] = None
    made_by: ClassVar[Callable[[type], Any]]

    @classmethod
    def register_class(cls) -> None:
        """Let scenes name it; an own one of the same name is replaced."""
        raise NotImplementedError

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest of its functions, for the run's settings; those of the package have a version."""
        return () if is_built_in(type(self)) else (self.definition.digest,)

    def parameters_in_natural_units(self, scales: Scales) -> Any:
        """Parameters of the section in natural units."""
        values = []
        for field in dataclasses.fields(self):
            kind = field.metadata["kind"]
            unit = kind.unit if isinstance(kind, QuantityKind) else "1"
            values.append(float(getattr(self, field.name)) / scales.natural_unit(unit))
        return self.definition.parameters(*values)

    def __reduce__(self) -> Any:
        """Any process can have it so: by the file's text, or by the class as it was written."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        if self.origin is not None:
            return _unpickle_from_file, (self.origin, self.definition.key, values)
        if self.__module__ != "__main__":
            return _unpickle_from_module, (type(self), values)
        return _unpickle_from_script, (type(self).made_by, self.user_class, values)


class CustomEffect(CustomSection, ForceEffect, DissipativeEffect):
    """Base of the effects that `effect` makes."""

    rank = 1

    @classmethod
    def register_class(cls) -> None:
        """Let scenes name it; an own one of the same name is replaced, a built-in one refused."""
        if not is_built_in(cls):  # which the registry knows by its file
            register_effect(cls)
        DEFINITIONS[cls.definition.digest] = cls.definition

    def make_kernel_law(self, context: EffectContext) -> CustomLaw:
        """Law in natural units."""
        p = self.parameters_in_natural_units(context.scales)
        check_effect_functions(self.definition, p, context)
        reach = self.definition.functions.get("reach")
        ends = math.inf if reach is None else float(reach(p))
        return CustomLaw(CustomLawKind(self.definition.digest), tuple(p), ends, None)

    def check_functions_compile(self, context: EffectContext) -> None:
        """Raise `InputError` if one of the effect's functions does not compile."""
        check_functions_compile(self.definition, self.parameters_in_natural_units(context.scales))

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency with which the effect changes in time [1/tau]."""
        result = self.definition.functions.get("frequency")
        return 0.0 if result is None else abs(float(result(self.parameters_in_natural_units(scales))))


class CustomWall(CustomSection):
    """Base of the wall laws that `wall_law` makes."""

    @classmethod
    def register_class(cls) -> None:
        """Let walls name it; an own one of the same name is replaced."""
        WALL_LAWS[cls.definition.key] = cls
        DEFINITIONS[cls.definition.digest] = cls.definition

    def make_kernel_law(self, scales: Scales) -> CustomWallLaw:
        """Law in natural units."""
        values = self.parameters_in_natural_units(scales)
        check_wall_functions(self.definition, values)
        return CustomWallLaw(CustomLawKind(self.definition.digest), tuple(values))


def effect(user_class: type) -> Any:
    """Make a class an effect that scenes can name; see the head of this file.

    Parameters
    ----------
    user_class : type
        A class with parameters (`quantity`) and static functions. Its name in small letters is what
        a scene calls it: ``LeafSpring`` is ``leaf_spring``. An own one of that name is replaced.

    Returns
    -------
    type
        A `CustomEffect` with the class's parameters, known to scenes by its name.

    Raises
    ------
    InputError
        If the class has no ``force``, ``flow`` or ``pair_force``, lacks the partner that a function needs
        (an ``energy`` for a force), has an unknown or a not static function, a parameter that is no
        `quantity`, or the name of a built-in effect. Functions with other arguments, that do not
        compile, or a force that is not minus the gradient of its energy, fail when a run begins.
    """
    key, functions = scene_key_of_class(user_class), static_methods_of(dict(vars(user_class)))
    if not set(functions) & {"force", "flow", "pair_force"}:
        raise InputError(
            f"effect {key!r} does nothing; give it a static method 'force', 'pair_force' or 'flow'"
        )
    needed = [_NEED[name] for name in functions if name in _NEED]
    meaning = (user_class.__doc__ or key).strip().splitlines()[0].rstrip(".")
    has_energy = "energy" in functions or "pair_energy" in functions
    made = make_section_class(
        user_class,
        CustomEffect,
        FUNCTIONS,
        needed,
        "effect",
        key=key,
        damps="flow" in functions,
        example=vars(user_class).get("example", True),
        energy_record=energy_variable(f"{key}_energy", f"energy of: {meaning}") if has_energy else None,
        loss_record=energy_variable(f"{key}_loss", f"lost to: {meaning}") if "flow" in functions else None,
    )
    made.register_class()
    return made


_NEED = {
    "force": "energy",
    "energy": "force",
    "stiffness": "energy",
    "power": "energy",
    "pair_force": "pair_energy",
    "pair_energy": "pair_force",
    "pair_stiffness": "pair_energy",
    "reach": "pair_energy",
}
"""The function without which one of these means nothing."""


def wall_law(user_class: type) -> Any:
    """Make a class a law that scenes can name for a wall; see the head of this file.

    Parameters
    ----------
    user_class : type
        Class with parameters (`quantity`) and static functions ``energy``, ``force`` and ``stiffness`` of
        the parameters and the distance. Its name in small letters is what a wall calls it; an own one
        of that name is replaced, and a built-in law keeps its name.

    Returns
    -------
    type
        A `CustomWall` with the class's parameters, known to walls by its name.

    Raises
    ------
    InputError
        If the class lacks one of the three, has an unknown or a not static function, or a parameter that
        is no `quantity`. Functions that do not compile, or a force that is not minus the slope of its
        energy, fail when a run begins.
    """
    made = make_section_class(user_class, CustomWall, WALL_FUNCTIONS, WALL_FUNCTIONS, "wall law")
    made.register_class()
    return made


def load_user_sections(file: UserFile) -> dict[str, type[CustomSection]]:
    """Load the effects and wall laws that a user's file defines; they know the file then."""
    result = {}
    for content in list(user_definitions(file).values()):
        own = isinstance(content, type) and issubclass(content, CustomSection)
        if own and content.__module__ == file.module_name:
            content.origin = file
            result[content.definition.key] = content
    return result


def _unpickle_from_file(file: UserFile, key: str, values: dict[str, Any]) -> Any:
    return load_user_sections(file)[key](**values)


def _unpickle_from_module(made: type, values: dict[str, Any]) -> Any:
    return made(**values)


def _unpickle_from_script(made_by: Callable[[type], Any], user_class: type, values: dict[str, Any]) -> Any:
    return made_by(user_class)(**values)


def make_section_class(
    user_class: type,
    base: type[CustomSection],
    allowed_functions: Sequence[str],
    required_functions: Sequence[str],
    what: str,
    /,
    **more: Any,
) -> Any:
    """Subclass of ``base`` with the class's parameters, and its functions as ``definition``."""
    key = scene_key_of_class(user_class)
    content = {
        name: value for name, value in vars(user_class).items() if name not in ("__dict__", "__weakref__")
    }
    functions = static_methods_of(content)
    for name in functions:
        if name not in allowed_functions:
            raise InputError(
                f"{what} {key!r}: {unknown_word_message(name, tuple(allowed_functions), 'function')}"
            )
    for name in required_functions:
        if name not in functions:
            raise InputError(f"{what} {key!r} has no {name!r}; give it, as a static method")
    for name, value in content.items():
        taken = hasattr(base, name) and name not in more
        if not name.startswith("_") and name not in functions and taken:
            raise InputError(f"{what} {key!r}: {quote(name)} has a meaning of its own; rename it")
        if isinstance(value, python_types.FunctionType):
            raise InputError(f"{what} {key!r}: {name!r} must be static; write @staticmethod above")
    fields = [
        name
        for name, kind in content.get("__annotations__", {}).items()
        if name not in functions and "ClassVar" not in str(kind)
    ]
    definition = CustomDefinition(
        what,
        key,
        f"{key}_{functions_digest(functions, fields)}",
        collections.namedtuple("Parameters", fields),
        functions,
        {name: _compile_kernel(function) for name, function in functions.items()},
    )
    for name in functions:
        del content[name]
    made = type(
        user_class.__name__, (base,), content | {"definition": definition, "user_class": user_class} | more
    )
    for field in dataclasses.fields(made):
        if field.name in fields and not isinstance(field.metadata.get("kind"), QuantityKind | IntegerKind):
            raise InputError(f"{what} {key!r}: {field.name} must be a number; give quantity(unit)")
    return made


def is_built_in(made: type) -> bool:
    """Return whether a class is defined in a file of the package's effects."""
    return made.__module__.rpartition(".")[0] == __name__.rpartition(".")[0]


def scene_key_of_class(user_class: type) -> str:
    """Name of a class in scenes: ``LeafSpring`` is ``leaf_spring``."""
    words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in user_class.__name__)
    return words.lstrip("_")


def static_methods_of(content: dict[str, Any]) -> dict[str, Callable[..., Any]]:
    """Return the static methods of a class by their names."""
    return {name: value.__func__ for name, value in content.items() if isinstance(value, staticmethod)}


def _compile_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    return numba.njit(**OPTIONS)(function)


CustomEffect.made_by, CustomWall.made_by = staticmethod(effect), staticmethod(wall_law)
