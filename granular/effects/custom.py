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
can be a formula as well: `granular.effects.formula`, `granular.effects.formula`,
and of the distance ``w`` of a wall:
``effects.walls.left = { energy = "a*(l/w)**3", a = "1 uJ", l = "6 mm" }``.

What is not there costs nothing. Compiled code is kept under a digest of the functions and of all
that they use of their file, so a second process starts as fast as with a built-in effect, and an
edited one is compiled anew.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import re
import types as python_types
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from granular.effects.custom_law import Definition, Grain, OwnEffectLaw, OwnLaw, OwnWallLaw
from granular.effects.effect import (
    EFFECTS,
    WALL_LAWS,
    DissipativeEffect,
    Effect,
    EffectContext,
    ForceEffect,
    energy_variable,
)
from granular.effects.pair_law import PairFunctions, PairLawEffect, Species, species_of_scene
from granular.schema.field_kinds import IntegerKind, QuantityKind
from granular.schema.natural_units import Scales
from granular.schema.sections import Section
from granular.shared.errors import InputError, quote, unknown_word_message
from granular.shared.function_digest import functions_digest
from granular.shared.user_file import UserFile, user_definitions

# Far above the error of the difference quotient, some 1e-11, and far below that of a wrong factor.
CLOSE = 1e-5
"""Relative difference between a derivative and what a function says."""
# Fourth-order differences at this step err by 1e-16 by truncation and 1e-12 by rounding.
_STEP = 1e-4
# Neither round nor symmetric, lest a wrong function be right by chance; a zero crossing hides an error.
_POINTS, _TIMES = ((0.31, 0.17), (0.52, 0.83), (0.77, 0.44)), (0.0, 0.37, 1.9)
_DISTANCES = (0.83, 1.21, 1.94)


def check_effect_functions(definition: Definition, p: Any, context: EffectContext) -> None:
    """Check an effect's functions against each other at a few points, in plain Python."""
    trial, names = _Trial(definition, p), definition.names
    width = context.cell.width / context.scales.length
    ends = len(context.grains.species)
    mass, moment = context.grains.mass_ratios(), context.grains.moment_ratios()
    grains = [
        Grain(x * width, y * width, float(mass[k % ends]), float(moment[k % ends]))
        for k, (x, y) in enumerate(_POINTS)
    ]
    for grain in grains:
        if "force" in names:
            for time in _TIMES:
                trial.check_force(grain, time)
        if "flow" in names:
            trial.check_flow(grain)


def check_pair_functions(definition: Definition, p: Any, species: Sequence[Species]) -> None:
    """Check that a pair law's functions are numbers, and that a given force is the slope of the energy."""
    trial = _Trial(definition, p)
    for first, second in itertools.combinations_with_replacement(species, 2):
        for r in _DISTANCES:
            trial.call("pair_energy", r, first, second)
            if "pair_force" in definition.names:
                trial.check_slope("pair_force", "pair_energy", r, first, second)
            if "pair_stiffness" in definition.names:
                trial.call("pair_stiffness", r, first, second)
        if "tail" in definition.names:
            trial.call("tail", first, second)
    if "reach" in definition.names:
        trial.call("reach")


def check_wall_functions(definition: Definition, p: Any) -> None:
    """Check that a wall law's force is minus the slope of its energy, at a few distances."""
    for w in _DISTANCES:
        _Trial(definition, p).check_slope("force", "energy", w)


class _Trial(NamedTuple):
    """A user's functions and parameters."""

    definition: Definition
    p: Any

    def call(self, name: str, *arguments: Any, count: int = 1) -> Any:
        """Call one of the functions, which is to return so many numbers."""
        try:
            result = self.definition.functions[name](self.p, *arguments)
            numbers = [float(value) for value in ((result,) if count == 1 else tuple(result))]
        except Exception as error:
            raise self.definition.error(f"{name!r} fails", error) from None
        if len(numbers) != count:
            raise self.refusal(f"{name!r} gives {len(numbers)} numbers, not {count}")
        return numbers[0] if count == 1 else numbers

    def refusal(self, words: str) -> InputError:
        """Make the error of functions that do not fit."""
        return InputError(f"{self.definition.display_name}: {words}")

    def compare(
        self, name: str, result: float, energy: Callable[[float], float], at: float, size: float
    ) -> None:
        """Compare what a function gives with the slope of an energy."""
        slope = _numerical_derivative(energy, at)
        if not (math.isfinite(result) and math.isfinite(slope)):
            return  # a position where it cannot be evaluated says nothing
        if abs(result - slope) > CLOSE * max(abs(slope), abs(result), size):
            raise self.refusal(
                f"{name!r} gives {result:.6g} where its energy asks for {slope:.6g} (natural units); "
                "correct one of them"
            )

    def check_slope(self, force: str, energy: str, distance: float, *others: Any) -> None:
        """Check that a function of a distance is minus the slope of another one."""
        result = self.call(force, distance, *others)
        size = 1e-6 * abs(self.call(energy, distance, *others))
        self.compare(force, result, lambda r: -self.call(energy, r, *others), distance, size)

    def check_force(self, grain: Grain, time: float) -> None:
        """Check that the force is minus the gradient, and the power the rate of change, of the energy."""
        fx, fy = self.call("force", grain, time, count=2)
        size = 1e-6 * abs(self.call("energy", grain, time))
        # One part in 1e3 of the other component counts as size: near a zero of this one, rounding of both
        # remains.
        for axis, component, other in (("x", fx, fy), ("y", fy, fx)):
            self.compare(
                "force",
                component,
                lambda position, axis=axis: -self.call("energy", grain._replace(**{axis: position}), time),  # type: ignore[misc]
                getattr(grain, axis),
                size + 1e-3 * abs(other),
            )
        power = self.call("power", grain, time) if "power" in self.definition.names else 0.0
        self.compare("power", power, lambda moment: self.call("energy", grain, moment), time, size)
        if "stiffness" in self.definition.names:
            self.call("stiffness", grain, time)

    def check_flow(self, grain: Grain) -> None:
        """Check that the flow takes energy, and is exact."""
        for vx, vy, dt in ((0.3, -0.2, 0.1), (0.0, 0.5, 0.02)):
            wx, wy = self.call("flow", grain, vx, vy, dt, count=2)
            # 1e-12: what rounding may add to a flow that takes nothing, a rotation for example.
            if wx * wx + wy * wy > (vx * vx + vy * vy) * (1.0 + 1e-12):
                raise self.refusal("'flow' makes a grain faster; it may only take energy")
            # Half a step before and half behind the drift must be a whole one, or the splitting loses its
            # order.
            twice = self.call("flow", grain, wx, wy, dt, count=2)
            total = self.call("flow", grain, vx, vy, 2.0 * dt, count=2)
            if not np.allclose(twice, total, rtol=1e-9, atol=1e-14):
                raise self.refusal(
                    "'flow' over two spans is not that over both together; solve it exactly, as "
                    "v*exp(-rate*dt)"
                )


def _numerical_derivative(function: Callable[[float], float], at: float) -> float:
    """Return the derivative, to the fourth order in the step."""
    h = _STEP * max(1.0, abs(at))
    near = function(at + h) - function(at - h)
    far = function(at + 2.0 * h) - function(at - 2.0 * h)
    return (8.0 * near - far) / (12.0 * h)


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
