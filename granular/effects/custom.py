"""Effects and wall laws that users define as decorated classes with static functions.

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

A scene can then contain ``effects.spring = { k = "10 N/m" }``; units and limits are checked. The functions
are compiled into the loop, so they may contain only code that Numba can compile: arithmetic, `math`, and
other compiled functions. Their arguments are the parameters ``p`` and a ``grain`` with ``x``, ``y``, ``mass``
and ``moment``. All are in natural units, in which a formula with consistent units has the same form as in SI.
An effect has one or more of these functions. ``energy`` and ``force`` require each other; ``stiffness`` and
``power`` require both:

``energy(p, grain, time)``, ``force(p, grain, time) -> (fx, fy)``
    For one grain; the force is minus the gradient of the energy.
``stiffness(p, grain, time)``
    Upper bound of the magnitude of the force's derivative with respect to position; it determines the
    automatic time step.
``power(p, grain, time)``
    External power, for an energy that depends on time: d(energy)/d(time) at a fixed position.
``flow(p, grain, vx, vy, dt) -> (vx, vy)``
    Exact velocity after ``dt`` if only a dissipative effect acts, for positive and negative ``dt``. The lost
    energy is recorded in the energy balance of the run.
``pair_energy(p, r, first, second)``
    Energy of two grains at distance r, each with ``mass``, ``moment`` and ``diameter`` of its species. The
    function is called in plain Python and tabulated (`granular.effects.pair_law`); the force is the
    derivative of the table. If ``pair_force`` and ``pair_stiffness`` are given, they are checked before the
    run, but not used in the run.
``tail(p, first, second)``
    Coefficient of 1/r^3 in the energy at large r, if any; this tail is summed over all pairs, like the dipole
    forces.
``reach(p)``
    Cut-off distance, beyond which only the tail acts. Default: the distance beyond which the energy is
    negligible.
``frequency(p)``
    Highest angular frequency of the effect's time dependence, which the time step must resolve.

A wall law is decorated with `wall_law`. It has three functions of the distance w of a grain of the first
species from the wall. For grains of other species, the values of the functions are multiplied by the moment
relative to the first species:

``energy(p, w)``, ``force(p, w)``, ``stiffness(p, w)``
    The force, positive away from the wall, is minus the derivative of the energy with respect to w. The
    stiffness is minus the derivative of the force.

A scene uses it as ``effects.walls.left = { law = "soft", k = "9 N/m", reach = "1 cm" }``. Effects and wall
laws can also be formulas (`granular.effects.formula`); the formula of a wall depends on the distance ``w``:
``effects.walls.left = { energy = "a*(l/w)**3", a = "1 uJ", l = "6 mm" }``.

Functions that are not defined take no computing time. Compiled code is cached under a digest of the functions
and of all code in their file that they use. Later processes therefore start without compilation, and edited
functions are compiled again.
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

from granular.effects.custom_law import CustomDefinition, CustomEffectLaw, CustomLaw, CustomWallLaw, Grain
from granular.effects.effect import (
    EFFECTS,
    WALL_LAWS,
    DissipativeEffect,
    Effect,
    EffectContext,
    ForceEffect,
    recorded_energy_variable,
)
from granular.effects.pair_law import PairFunctions, PairLawEffect, Species, species_of_scene
from granular.schema.field_kinds import IntegerKind, QuantityKind
from granular.schema.natural_units import Scales
from granular.schema.sections import Section
from granular.shared.errors import InputError, quote, unknown_word_message
from granular.shared.function_digest import functions_digest
from granular.shared.user_file import UserFile, user_definitions

# Far above the error of the difference quotient, about 1e-11, and far below the error of a wrong factor.
CLOSE = 1e-5
"""Maximum relative difference between a numerical derivative and the value of a user's function."""
# Fourth-order differences with this step have a truncation error of 1e-16 and a rounding error of 1e-12.
_STEP = 1e-4
# Neither round nor symmetric, lest a wrong function be right by chance; a zero crossing hides an error.
_POINTS, _TIMES = ((0.31, 0.17), (0.52, 0.83), (0.77, 0.44)), (0.0, 0.37, 1.9)
_DISTANCES = (0.83, 1.21, 1.94)


def check_effect_functions(definition: CustomDefinition, p: Any, context: EffectContext) -> None:
    """Check at a few points, in plain Python, that an effect's functions are consistent with each other."""
    trial, names = _UserFunctionChecker(definition, p), definition.names
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


def check_pair_functions(definition: CustomDefinition, p: Any, species: Sequence[Species]) -> None:
    """Check that a pair law's functions return numbers, and that the force is minus dE/dr."""
    trial = _UserFunctionChecker(definition, p)
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


def check_wall_functions(definition: CustomDefinition, p: Any) -> None:
    """Check that a wall law's force is minus the derivative of its energy, at a few distances."""
    for w in _DISTANCES:
        _UserFunctionChecker(definition, p).check_slope("force", "energy", w)


class _UserFunctionChecker(NamedTuple):
    """Calls a user's functions with the user's parameters, and checks their results."""

    definition: CustomDefinition
    p: Any

    def call(self, name: str, *arguments: Any, count: int = 1) -> Any:
        """Call the user's function of this name, and check that it returns ``count`` numbers."""
        try:
            result = self.definition.functions[name](self.p, *arguments)
            numbers = [float(value) for value in ((result,) if count == 1 else tuple(result))]
        except Exception as error:
            raise self.definition.error(f"{name!r} fails", error) from None
        if len(numbers) != count:
            raise self.inconsistency_error(f"{name!r} returns {len(numbers)} numbers; it must return {count}")
        return numbers[0] if count == 1 else numbers

    def inconsistency_error(self, words: str) -> InputError:
        """Make an error whose message begins with the name of the user's effect, law or stage."""
        return InputError(f"{self.definition.display_name}: {words}")

    def check_equal_to_slope(
        self, name: str, result: float, energy: Callable[[float], float], at: float, size: float
    ) -> None:
        """Check that the result of a function equals the derivative of an energy."""
        slope = _numerical_derivative(energy, at)
        if not (math.isfinite(result) and math.isfinite(slope)):
            return  # the functions cannot be compared at this position
        if abs(result - slope) > CLOSE * max(abs(slope), abs(result), size):
            raise self.inconsistency_error(
                f"{name!r} returns {result:.6g}, but the derivative of the energy requires {slope:.6g} "
                "(natural units); correct the function or the energy"
            )

    def check_slope(self, force: str, energy: str, distance: float, *others: Any) -> None:
        """Check that one function of a distance is minus the derivative of another."""
        result = self.call(force, distance, *others)
        size = 1e-6 * abs(self.call(energy, distance, *others))
        self.check_equal_to_slope(force, result, lambda r: -self.call(energy, r, *others), distance, size)

    def check_force(self, grain: Grain, time: float) -> None:
        """Check the force (minus the energy's gradient) and the power (the energy's rate of change)."""
        fx, fy = self.call("force", grain, time, count=2)
        size = 1e-6 * abs(self.call("energy", grain, time))
        # The scale includes 1e-3 of the other component: near a zero of this component, the rounding errors
        # of both remain.
        for axis, component, other in (("x", fx, fy), ("y", fy, fx)):
            self.check_equal_to_slope(
                "force",
                component,
                lambda position, axis=axis: -self.call("energy", grain._replace(**{axis: position}), time),  # type: ignore[misc]
                getattr(grain, axis),
                size + 1e-3 * abs(other),
            )
        power = self.call("power", grain, time) if "power" in self.definition.names else 0.0
        self.check_equal_to_slope(
            "power", power, lambda moment: self.call("energy", grain, moment), time, size
        )
        if "stiffness" in self.definition.names:
            self.call("stiffness", grain, time)

    def check_flow(self, grain: Grain) -> None:
        """Check that ``flow`` dissipates energy and is the exact solution for every time step."""
        for vx, vy, dt in ((0.3, -0.2, 0.1), (0.0, 0.5, 0.02)):
            wx, wy = self.call("flow", grain, vx, vy, dt, count=2)
            # 1e-12 allows for rounding in a flow that conserves energy, such as a rotation.
            if wx * wx + wy * wy > (vx * vx + vy * vy) * (1.0 + 1e-12):
                raise self.inconsistency_error(
                    "'flow' increases a grain's speed, but must not add energy; correct it"
                )
            # Half a step before the drift and half a step after it must make one whole step, or the splitting
            # loses its order.
            twice = self.call("flow", grain, wx, wy, dt, count=2)
            total = self.call("flow", grain, vx, vy, 2.0 * dt, count=2)
            if not np.allclose(twice, total, rtol=1e-9, atol=1e-14):
                raise self.inconsistency_error(
                    "'flow' applied twice with dt differs from 'flow' applied once with 2*dt; return the "
                    "exact solution, such as v*exp(-rate*dt)"
                )


def _numerical_derivative(function: Callable[[float], float], at: float) -> float:
    """Return the derivative by central differences of fourth order."""
    h = _STEP * max(1.0, abs(at))
    near = function(at + h) - function(at - h)
    far = function(at + 2.0 * h) - function(at - 2.0 * h)
    return (8.0 * near - far) / (12.0 * h)


class CustomPart(Section):
    """Base class of scene sections with user-defined functions, given by a class or a formula."""

    law_base: ClassVar[type[CustomLaw] | None] = None

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Values of the parameters with their SI units, in the order of the definition."""
        raise NotImplementedError

    def parameters_in_natural_units(self, scales: Scales) -> Any:
        """Parameters in natural units, for the user's functions and the loop."""
        definition: CustomDefinition = self.definition  # type: ignore[attr-defined]  # set by the maker
        return definition.law_class(
            *(float(value) / scales.natural_unit(unit) for value, unit in self.parameters)
        )

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest (hash) of the user-defined functions, to identify a run; empty for built-in functions."""
        return () if is_built_in_effect_class(type(self)) else (self.definition.digest,)  # type: ignore[attr-defined]


class CustomSection(CustomPart):
    """Base class of sections made from a user's class.

    Attributes
    ----------
    noun : str
        Word for the section in messages, such as "effect".
    partners : mapping of str to str or None
        Functions that the class may have, each with the function that it requires, or None.
    needed : tuple of str
        Functions of which the class must have at least one.
    definition : CustomDefinition
    user_class : type
        The class that the user wrote.
    origin : UserFile or None
        File that contains the class, if a file was given on the command line.
    """

    noun: ClassVar[str]
    partners: ClassVar[Mapping[str, str | None]]
    needed: ClassVar[tuple[str, ...]]
    definition: ClassVar[CustomDefinition]
    user_class: ClassVar[type]
    origin: ClassVar[UserFile | None] = None

    @classmethod
    def class_attributes(cls, key: str, user_class: type) -> dict[str, Any]:
        """Attributes of the new class that follow from the user's class."""
        return {}

    @classmethod
    def register_class(cls) -> None:
        """Register the class for use in scenes; it replaces a custom class of the same name."""
        raise NotImplementedError

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Values of the parameters with their SI units, in the order of the fields."""
        kinds = [(field.name, field.metadata["kind"]) for field in dataclasses.fields(self)]
        return [(getattr(self, name), getattr(kind, "unit", "1")) for name, kind in kinds]

    def __reduce__(self) -> Any:
        """Pickle together with the user's file or class, so that any process can load the object."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        if self.origin is not None:
            return _unpickle_custom_section, (self.origin, self.definition.key, values)
        if self.__module__ != "__main__":
            return _unpickle_custom_section, (None, type(self), values)
        return _unpickle_custom_section, (type(self).__base__, self.user_class, values)


def _unpickle_custom_section(
    origin: UserFile | type[CustomSection] | None, made: Any, values: dict[str, Any]
) -> Any:
    if isinstance(origin, UserFile):
        made = load_user_sections(origin)[made]
    elif origin is not None:
        made = make_and_register_section_class(made, origin)
    return made(**values)


class CustomEffect(CustomSection, ForceEffect, DissipativeEffect):
    """Base class of the effects made by `effect`."""

    rank = 1
    noun = "effect"
    law_base = CustomEffectLaw
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
        """Key, records and other class attributes of the effect."""
        content = vars(user_class)
        meaning = (user_class.__doc__ or key).strip().splitlines()[0].rstrip(".")
        conserves, damps = "energy" in content or "pair_energy" in content, "flow" in content
        return {
            "key": key,
            "damps": damps,
            "periodic": "pair_energy" in content and not {"energy", "force", "flow"} & set(content),
            "example": content.get("example", True),
            "energy_record": recorded_energy_variable(f"{key}_energy", f"energy of: {meaning}")
            if conserves
            else None,
            "loss_record": recorded_energy_variable(f"{key}_loss", f"lost to: {meaning}") if damps else None,
        }

    @classmethod
    def register_class(cls) -> None:
        """Register a custom effect for use in scenes; it replaces a custom effect of the same name."""
        if not is_built_in_effect_class(cls):  # built-in effects are in the registry already
            EFFECTS.register(cls.key, cls)

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """Return one effect for functions of single grains, and one for functions of pairs, if defined."""
        names = set(self.definition.names)
        if "pair_energy" not in names:
            return (self,)
        return (self, _CustomPairLaw(self)) if names & {"force", "flow"} else (_CustomPairLaw(self),)

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Make the law for the compiled loop, in natural units."""
        law = self.parameters_in_natural_units(context.scales)
        check_effect_functions(self.definition, law, context)
        return law

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency with which the effect changes in time [1/tau]."""
        result = self.definition.functions.get("frequency")
        return 0.0 if result is None else abs(float(result(self.parameters_in_natural_units(scales))))


class _CustomPairLaw(PairLawEffect):
    """Pair law of a custom effect."""

    def __init__(self, owner: CustomEffect) -> None:
        for name, value in (("owner", owner), ("key", owner.key), ("energy_record", owner.energy_record)):
            object.__setattr__(self, name, value)

    if TYPE_CHECKING:
        owner: CustomEffect

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest (hash) of the functions of the custom effect."""
        return self.owner.user_code_digests

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the user's functions, with the parameters in natural units."""
        definition, law = self.owner.definition, self.owner.parameters_in_natural_units(context.scales)
        check_pair_functions(definition, law, species_of_scene(context))
        functions = definition.functions
        return PairFunctions(
            key=(definition.digest, tuple(law)),
            reach=float(functions["reach"](law)) if "reach" in functions else math.inf,
            name=definition.display_name,
            energy=functools.partial(functions["pair_energy"], law),
            tail=functools.partial(functions["tail"], law) if "tail" in functions else None,
        )


class CustomWall(CustomSection):
    """Base class of the wall laws made by `wall_law`."""

    noun = "wall law"
    law_base = CustomWallLaw
    needed = ("force",)
    partners: ClassVar[Mapping[str, str | None]] = {
        "energy": "force",
        "force": "stiffness",
        "stiffness": "energy",
    }

    @classmethod
    def register_class(cls) -> None:
        """Register the law for use in walls; it replaces a custom law of the same name."""
        WALL_LAWS.register(cls.definition.key, cls)

    def make_kernel_law(self, scales: Scales) -> Any:
        """Make the law for the compiled loop, in natural units."""
        law = self.parameters_in_natural_units(scales)
        check_wall_functions(self.definition, law)
        return law


def effect(user_class: type) -> Any:
    """Turn a class into an effect for scenes; `granular.effects.custom` describes the functions.

    Parameters
    ----------
    user_class : type
        A class with parameters (`quantity`) and static functions. In scenes the effect has the class's name
        in lower case: ``leaf_spring`` for ``LeafSpring``. An earlier custom effect with this name is
        replaced.

    Returns
    -------
    type
        A subclass of `CustomEffect` with the class's parameters, registered for scenes by its name.

    Raises
    ------
    InputError
        If the class has no ``force``, ``flow`` or ``pair_energy``, or lacks a function that another function
        requires (``force`` requires ``energy``). Also if a function is unknown or not static, a parameter is
        not a `quantity`, or a built-in effect has the same name. Three errors are raised only at the start of
        a run: functions with wrong arguments, functions that do not compile, and a force that is not minus
        the gradient of its energy.
    """
    return make_and_register_section_class(user_class, CustomEffect)


def wall_law(user_class: type) -> Any:
    """Turn a class into a wall law for scenes; `granular.effects.custom` describes the functions.

    Parameters
    ----------
    user_class : type
        Class with parameters (`quantity`) and static functions ``energy``, ``force`` and ``stiffness`` of the
        parameters and the distance. In scenes the law has the class's name in lower case. An earlier custom
        law with this name is replaced; a built-in law is not.

    Returns
    -------
    type
        A subclass of `CustomWall` with the class's parameters, registered for walls by its name.

    Raises
    ------
    InputError
        If the class lacks one of the three functions, has an unknown or non-static function, or a parameter
        that is not a `quantity`. Functions that do not compile, and a force that is not minus the derivative
        of its energy, raise this error only at the start of a run.
    """
    return make_and_register_section_class(user_class, CustomWall)


def make_and_register_section_class(user_class: type, base: type[CustomSection]) -> Any:
    """Make a subclass of ``base`` with a class's parameters and functions, and register it for scenes."""
    written = {
        name: value for name, value in vars(user_class).items() if name not in ("__dict__", "__weakref__")
    }
    key = scene_key_of_class(user_class)
    functions = {name: value.__func__ for name, value in written.items() if isinstance(value, staticmethod)}
    more = base.class_attributes(key, user_class)
    _check_names_in_class(f"{base.noun} {key!r}", written, functions, base, more)
    content = {name: value for name, value in written.items() if name not in functions}
    made = type(user_class.__name__, (base,), content | more | {"user_class": user_class})
    fields = [field for field in dataclasses.fields(made) if field.name not in base.key_names()]
    for field in fields:
        if not isinstance(field.metadata.get("kind"), QuantityKind | IntegerKind):
            raise InputError(
                f"{base.noun} {key!r}: {field.name} is not declared as a number; declare it by quantity(unit)"
            )
    names = tuple(field.name for field in fields)
    digest = f"{key}_{functions_digest(functions, names)}"
    made.definition = CustomDefinition(  # type: ignore[attr-defined]  # a class made here
        base.noun, key, digest, names, tuple(functions), lambda: functions, base.law_base
    )
    made.register_class()  # type: ignore[attr-defined]  # made of a custom base
    return made


def _check_names_in_class(
    who: str,
    written: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    base: type[CustomSection],
    more: Mapping[str, Any],
) -> None:
    """Check the names in a user's class, and that it has all functions required by others."""
    if not set(functions) & set(base.needed):
        wanted = " or ".join(map(repr, base.needed))
        raise InputError(f"{who} has no function that can act; add a static method {wanted}")
    for name in functions:
        if name not in base.partners:
            raise InputError(f"{who}: {unknown_word_message(name, tuple(base.partners), 'function')}")
        partner = base.partners[name]
        if partner is not None and partner not in functions:
            raise InputError(f"{who} has no {partner!r}; add it as a static method")
    reserved = {*dir(base), *dir(base.law_base), *getattr(base.law_base, "extra_fields", ())} - set(more)
    for name, value in written.items():
        if not name.startswith("_") and name not in functions and name in reserved:
            raise InputError(f"{who}: {quote(name)} is reserved; rename it")
        if isinstance(value, python_types.FunctionType):
            raise InputError(f"{who}: {name!r} must be static; write @staticmethod above it")


def load_user_sections(file: UserFile) -> dict[str, type[CustomSection]]:
    """Load the effects, wall laws and stages of a user's file; store the file as their ``origin``."""
    result = {}
    for content in list(user_definitions(file).values()):
        own = isinstance(content, type) and issubclass(content, CustomSection)
        if own and content.__module__ == file.module_name:
            content.origin = file
            result[content.definition.key] = content
    return result


def is_built_in_effect_class(made: type) -> bool:
    """Return True if a class is defined among the package's effects."""
    return made.__module__.rpartition(".")[0] == __name__.rpartition(".")[0]


def scene_key_of_class(user_class: type) -> str:
    """Return the key in scenes for a class: ``leaf_spring`` for ``LeafSpring``."""
    return re.sub("(?=[A-Z])", "_", user_class.__name__).lower().lstrip("_")
