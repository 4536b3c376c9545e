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
``pair_energy(p, r, first, second)``
    Of two grains at the distance r, each with ``mass``, ``moment`` and ``diameter`` of its species. It is
    called in plain Python and tabulated, `granular.effects.pair_law`; the force is the table's derivative.
    A ``pair_force`` and a ``pair_stiffness``, if there are any, are compared with it, and no more.
``tail(p, first, second)``
    Its coefficient of 1/r^3 far away, if it has one; summed over all pairs as that of the dipoles is.
``reach(p)``
    Distance from which on a pair does nothing, but for its tail; without it, where the energy has ended.
``frequency(p)``
    Highest angular frequency with which it changes in time, for the step.

A law of a wall is decorated with `wall_law` and has, of a grain of the first species at the
distance w (others feel it in the ratio of their moments):

``energy(p, w)``, ``force(p, w)``, ``stiffness(p, w)``
    Force away from the wall, minus the slope of the energy; and minus its own slope.

A scene names it as ``effects.walls.left = { law = "soft", k = "9 N/m", reach = "1 cm" }``. Either
can be a formula as well: `granular.effects.formula`, `granular.effects.pair_formula`,
and of the distance ``w`` of a wall:
``effects.walls.left = { energy = "a*(l/w)**3", a = "1 uJ", l = "6 mm" }``.

What is not there costs nothing. Compiled code is kept under a digest of the functions and of all
that they use of their file, so a second process starts as fast as with a built-in effect, and an
edited one is compiled anew.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import types as python_types
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from granular.effects.custom_function_checks import (
    check_effect_functions,
    check_pair_functions,
    check_wall_functions,
)
from granular.effects.custom_law import Definition, OwnEffectLaw, OwnLaw, OwnWallLaw
from granular.effects.dissipative_effect import DissipativeEffect
from granular.effects.effect import Effect, EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.pair_law import PairFunctions, PairLawEffect, species_of_scene
from granular.effects.registry import EFFECTS, WALL_LAWS
from granular.schema.field_kinds import IntegerKind, QuantityKind
from granular.schema.natural_units import Scales
from granular.schema.sections import Section
from granular.shared.errors import InputError
from granular.shared.function_digest import functions_digest
from granular.shared.message_text import quote, unknown_word_message
from granular.shared.user_file import UserFile, user_definitions


class OwnPart(Section):
    """Base of what has a user's functions: written as a class, or derived from a formula."""

    law_base: ClassVar[type[OwnLaw] | None] = None

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Numbers of the parameters and their SI units, in the order of the definition's."""
        raise NotImplementedError

    def natural_law(self, scales: Scales) -> Any:
        """Parameters in natural units, as the user's functions and the loop take them."""
        definition: Definition = self.definition  # type: ignore[attr-defined]
        return definition.law(*(float(value) / scales.natural_unit(unit) for value, unit in self.parameters))

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest of its functions, for the run's settings; those of the package have a version."""
        return () if is_built_in(type(self)) else (self.definition.digest,)  # type: ignore[attr-defined]


class OwnSection(OwnPart):
    """Base of what is made of a user's class.

    Attributes
    ----------
    what : str
        What it is called in messages.
    partners : mapping of str to str or None
        Functions that the class may have, and for each the one without which it means nothing.
    needed : tuple of str
        Functions of which the class must have one.
    definition : Definition
    user_class : type
        The class as it was written.
    origin : UserFile or None
        The file that it came from, where the command line named one.
    """

    what: ClassVar[str]
    partners: ClassVar[Mapping[str, str | None]]
    needed: ClassVar[tuple[str, ...]]
    definition: ClassVar[Definition]
    user_class: ClassVar[type]
    origin: ClassVar[UserFile | None] = None

    @classmethod
    def class_attributes(cls, key: str, user_class: type) -> dict[str, Any]:
        """Attributes of the made class that follow from the user's."""
        return {}

    @classmethod
    def register_class(cls) -> None:
        """Let scenes name it; an own one of the same name is replaced."""
        raise NotImplementedError

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Numbers of the parameters and their SI units, in the order of the fields."""
        kinds = [(field.name, field.metadata["kind"]) for field in dataclasses.fields(self)]
        return [(getattr(self, name), getattr(kind, "unit", "1")) for name, kind in kinds]

    def __reduce__(self) -> Any:
        """Any process can have it so: by the file's text, or by the class as it was written."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        if self.origin is not None:
            return _unpickle, (self.origin, self.definition.key, values)
        if self.__module__ != "__main__":
            return _unpickle, (None, type(self), values)
        return _unpickle, (type(self).__base__, self.user_class, values)


def _unpickle(origin: UserFile | type[OwnSection] | None, made: Any, values: dict[str, Any]) -> Any:
    if isinstance(origin, UserFile):
        made = load_user_sections(origin)[made]
    elif origin is not None:
        made = make_section_class(made, origin)
    return made(**values)


class OwnEffect(OwnSection, ForceEffect, DissipativeEffect):
    """Base of the effects that `effect` makes."""

    rank = 1
    what = "effect"
    law_base = OwnEffectLaw
    needed = ("force", "pair_energy", "flow")
    partners: ClassVar[Mapping[str, str | None]] = {
        "energy": "force",
        "force": "energy",
        "stiffness": "energy",
        "power": "energy",
        "flow": None,
        "pair_energy": None,
        "pair_force": "pair_energy",
        "pair_stiffness": "pair_energy",
        "tail": "pair_energy",
        "reach": "pair_energy",
        "frequency": None,
    }

    @classmethod
    def class_attributes(cls, key: str, user_class: type) -> dict[str, Any]:
        """Name and records of the effect."""
        content = vars(user_class)
        meaning = (user_class.__doc__ or key).strip().splitlines()[0].rstrip(".")
        conserves, damps = "energy" in content or "pair_energy" in content, "flow" in content
        return {
            "key": key,
            "damps": damps,
            "periodic": "pair_energy" in content and not {"energy", "force", "flow"} & set(content),
            "example": content.get("example", True),
            "energy_record": energy_variable(f"{key}_energy", f"energy of: {meaning}") if conserves else None,
            "loss_record": energy_variable(f"{key}_loss", f"lost to: {meaning}") if damps else None,
        }

    @classmethod
    def register_class(cls) -> None:
        """Let scenes name it; an own one of the same name is replaced, a built-in one refused."""
        if not is_built_in(cls):  # which the registry names itself
            EFFECTS.register(cls.key, cls)

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """The effect of its functions of a grain, and that of its functions of a pair."""
        names = set(self.definition.names)
        if "pair_energy" not in names:
            return (self,)
        return (self, _OwnPairLaw(self)) if names & {"force", "flow"} else (_OwnPairLaw(self),)

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Law in natural units."""
        law = self.natural_law(context.scales)
        check_effect_functions(self.definition, law, context)
        return law

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency with which the effect changes in time [1/tau]."""
        result = self.definition.functions.get("frequency")
        return 0.0 if result is None else abs(float(result(self.natural_law(scales))))


class _OwnPairLaw(PairLawEffect):
    """Pair law of an own effect."""

    def __init__(self, owner: OwnEffect) -> None:
        for name, value in (("owner", owner), ("key", owner.key), ("energy_record", owner.energy_record)):
            object.__setattr__(self, name, value)

    if TYPE_CHECKING:
        owner: OwnEffect

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest of the owner's functions."""
        return self.owner.user_code_digests

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the user's functions, with the parameters in natural units."""
        definition, law = self.owner.definition, self.owner.natural_law(context.scales)
        check_pair_functions(definition, law, species_of_scene(context))
        functions = definition.functions
        return PairFunctions(
            key=(definition.digest, tuple(law)),
            reach=float(functions["reach"](law)) if "reach" in functions else math.inf,
            name=definition.display_name,
            energy=functools.partial(functions["pair_energy"], law),
            tail=functools.partial(functions["tail"], law) if "tail" in functions else None,
        )


class OwnWall(OwnSection):
    """Base of the wall laws that `wall_law` makes."""

    what = "wall law"
    law_base = OwnWallLaw
    needed = ("force",)
    partners: ClassVar[Mapping[str, str | None]] = {
        "energy": "force",
        "force": "stiffness",
        "stiffness": "energy",
    }

    @classmethod
    def register_class(cls) -> None:
        """Let walls name it; an own one of the same name is replaced."""
        WALL_LAWS.register(cls.definition.key, cls)

    def make_kernel_law(self, scales: Scales) -> Any:
        """Law in natural units."""
        law = self.natural_law(scales)
        check_wall_functions(self.definition, law)
        return law


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
        An `OwnEffect` with the class's parameters, known to scenes by its name.

    Raises
    ------
    InputError
        If the class has no ``force``, ``flow`` or ``pair_energy``, lacks the partner that a function needs
        (an ``energy`` for a force), has an unknown or a not static function, a parameter that is no
        `quantity`, or the name of a built-in effect. Functions with other arguments, that do not
        compile, or a force that is not minus the gradient of its energy, fail when a run begins.
    """
    return make_section_class(user_class, OwnEffect)


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
        An `OwnWall` with the class's parameters, known to walls by its name.

    Raises
    ------
    InputError
        If the class lacks one of the three, has an unknown or a not static function, or a parameter that
        is no `quantity`. Functions that do not compile, or a force that is not minus the slope of its
        energy, fail when a run begins.
    """
    return make_section_class(user_class, OwnWall)


def make_section_class(user_class: type, base: type[OwnSection]) -> Any:
    """Make a subclass of ``base`` with the class's parameters and functions, which scenes know."""
    written = {
        name: value for name, value in vars(user_class).items() if name not in ("__dict__", "__weakref__")
    }
    key = scene_key_of_class(user_class)
    functions = {name: value.__func__ for name, value in written.items() if isinstance(value, staticmethod)}
    more = base.class_attributes(key, user_class)
    _check_class(f"{base.what} {key!r}", written, functions, base, more)
    content = {name: value for name, value in written.items() if name not in functions}
    made = type(user_class.__name__, (base,), content | more | {"user_class": user_class})
    fields = [field for field in dataclasses.fields(made) if field.name not in base.key_names()]
    for field in fields:
        if not isinstance(field.metadata.get("kind"), QuantityKind | IntegerKind):
            raise InputError(f"{base.what} {key!r}: {field.name} must be a number; give quantity(unit)")
    names = tuple(field.name for field in fields)
    digest = f"{key}_{functions_digest(functions, names)}"
    made.definition = Definition(  # type: ignore[attr-defined]
        base.what, key, digest, names, tuple(functions), lambda: functions, base.law_base
    )
    made.register_class()  # type: ignore[attr-defined]
    return made


def _check_class(
    who: str,
    written: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    base: type[OwnSection],
    more: Mapping[str, Any],
) -> None:
    """Check the names of a user's class."""
    if not set(functions) & set(base.needed):
        wanted = " or ".join(map(repr, base.needed))
        raise InputError(f"{who} does nothing; give it a static method {wanted}")
    for name in functions:
        if name not in base.partners:
            raise InputError(f"{who}: {unknown_word_message(name, tuple(base.partners), 'function')}")
        partner = base.partners[name]
        if partner is not None and partner not in functions:
            raise InputError(f"{who} has no {partner!r}; give it, as a static method")
    reserved = {*dir(base), *dir(base.law_base), *getattr(base.law_base, "extra_fields", ())} - set(more)
    for name, value in written.items():
        if not name.startswith("_") and name not in functions and name in reserved:
            raise InputError(f"{who}: {quote(name)} has a meaning of its own; rename it")
        if isinstance(value, python_types.FunctionType):
            raise InputError(f"{who}: {name!r} must be static; write @staticmethod above")


def load_user_sections(file: UserFile) -> dict[str, type[OwnSection]]:
    """Load the effects, wall laws and stages that a user's file defines; they know the file then."""
    result = {}
    for content in list(user_definitions(file).values()):
        own = isinstance(content, type) and issubclass(content, OwnSection)
        if own and content.__module__ == file.module_name:
            content.origin = file
            result[content.definition.key] = content
    return result


def is_built_in(made: type) -> bool:
    """Return whether a class is defined in a file of the package's effects."""
    return made.__module__.rpartition(".")[0] == __name__.rpartition(".")[0]


def scene_key_of_class(user_class: type) -> str:
    """Name of a class in scenes: ``LeafSpring`` is ``leaf_spring``."""
    return re.sub("(?=[A-Z])", "_", user_class.__name__).lower().lstrip("_")
