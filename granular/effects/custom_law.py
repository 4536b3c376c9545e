"""User-defined laws for the compiled loop: named tuples whose hooks call the user's functions.

A hook is a static method of a law that the loop calls at a fixed point of a time step. A custom law is a
named tuple of parameters in natural units, the ``p`` of the user's functions. The class of the tuple is made
from a `CustomDefinition`, and its name contains the digest (hash) under which compiled code is cached. The
hooks are made only when a loop is compiled, since SymPy takes half a second to derive a formula's functions.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numba
from numba.core.errors import NumbaError
from numba.core.registry import CPUDispatcher

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import OPTIONS
from granular.kernel_data.state import LOSSES, WORK, Bed, Constants, State, relative_moments
from granular.pairs.grain_arrays import value_or_one
from granular.shared.errors import InputError, one_line

Functions = Mapping[str, Any]


class Grain(NamedTuple):
    """A grain for a custom effect's functions: x, y [D]; mass and moment relative to the first species."""

    x: float
    y: float
    mass: float
    moment: float


@dataclasses.dataclass(frozen=True, eq=False)
class CustomDefinition:
    """Functions of a custom effect, law or stage, identified by a digest."""

    noun: str
    key: str
    digest: str
    parameters: tuple[str, ...]
    names: tuple[str, ...]  # of the functions
    make_functions: Callable[[], Functions]  # called when a function is first needed
    law_base: type[CustomLaw] | None  # None without a law in the loop

    @property
    def display_name(self) -> str:
        """Name of the definition in messages."""
        return f"{self.noun} {self.key!r}"

    def error(self, words: str, error: BaseException) -> InputError:
        """Return a one-line error for an exception in the user's code."""
        return InputError(
            f"{self.display_name}: {words}: {type(error).__name__}: {one_line(error)}; correct it"
        )

    @functools.cached_property
    def functions(self) -> Functions:
        """The user's functions in plain Python, by name."""
        return self.make_functions()

    @functools.cached_property
    def hooks(self) -> Functions:
        """Compiled hooks of the law, by name."""
        assert self.law_base is not None
        return self.law_base.make_hooks(
            {name: _compile_user_function(self, name, function) for name, function in self.functions.items()}
        )

    @functools.cached_property
    def law_class(self) -> Any:
        """Class of the law; definitions with equal digests share one class."""
        assert self.law_base is not None
        if not hasattr(CustomLawRegistry, self.digest):
            extra = self.law_base.extra_fields
            names = (*self.parameters, *extra)
            values = collections.namedtuple("Values", names, defaults=extra.values())  # type: ignore[misc]
            origin = {"__module__": __name__, "__qualname__": f"{CustomLawRegistry.__name__}.{self.digest}"}
            made = _CustomLawMetaclass(self.digest, (values, self.law_base), {"_definition": self, **origin})
            setattr(CustomLawRegistry, self.digest, made)
        return getattr(CustomLawRegistry, self.digest)


class CustomLawRegistry:
    """Classes of custom laws, named by their digests; cached compiled code looks up the classes here."""


class _CustomLawMetaclass(type):
    """Metaclass of custom laws, which makes a hook when the compiler first needs it."""

    _definition: CustomDefinition

    def __getattr__(cls, name: str) -> Any:
        base: Any = cls
        if name.startswith("_") or name not in base.hook_names(base._definition.names):
            raise AttributeError(f"a custom law has no attribute {name!r}")
        return base._definition.hooks[name]


class CustomLaw(metaclass=_CustomLawMetaclass):
    """Base class of custom laws."""

    extra_fields: ClassVar[Mapping[str, Any]] = {}  # in addition to the parameters, with default values

    @staticmethod
    def hook_names(names: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the hooks of a law, from the names of its functions."""
        raise NotImplementedError

    @staticmethod
    def make_hooks(user: Functions) -> Functions:
        """Make the hooks from the user's compiled functions, by name."""
        raise NotImplementedError

    def __getattr__(self, name: str) -> Any:
        """Return a hook of the class, for calls from plain Python."""
        return getattr(type(self), name)


class UserKernel(CPUDispatcher):  # type: ignore[misc]  # Numba is not typed
    """A compiled user function, whose compiler errors are one line long."""

    name_in_messages = ""

    def compile(self, sig: Any) -> Any:
        """Compile the function, or raise a one-line error."""
        try:
            return super().compile(sig)
        except NumbaError as error:
            raise InputError(
                f"{self.name_in_messages} does not compile: {_most_informative_error_line(error)}; use only "
                "arithmetic, math and compiled functions"
            ) from None


def _compile_user_function(definition: CustomDefinition, name: str, function: Callable[..., Any]) -> Any:
    kernel = numba.njit(**OPTIONS)(function)
    if isinstance(kernel, CPUDispatcher):  # a plain function if compilation is disabled
        kernel.__class__ = UserKernel
        kernel.name_in_messages = f"{definition.display_name}: {name!r}"
    return kernel


def _most_informative_error_line(error: BaseException) -> str:
    """Return the most informative line of the compiler's message."""
    lines = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()]
    shown = [line for line in lines if line and not line.startswith(("Failed in", "During", "File"))]
    return one_line(shown[0] if shown else type(error).__name__)


@numba.njit(**OPTIONS)
def _return_zero(*arguments: Any) -> int:
    return 0


@compiled(inline=True)
def make_grain(state: State, constants: Constants, i: int) -> Grain:
    """Make the `Grain` that is passed to the user's functions."""
    mass, moment = value_or_one(constants.masses, i), value_or_one(relative_moments(constants), i)
    return Grain(state.x[i], state.y[i], mass, moment)


_HOOKS = {
    "force": "add_forces",
    "energy": "measure_energy_and_stiffness",
    "power": "record_external_work",
    "flow": "damp_velocities",
}
"""For each function of the user, the hook that calls the function."""


def _make_grain_hooks(user: Functions) -> Functions:
    """Make the hooks of an effect from the user's compiled functions, by name."""
    force, energy, stiffness, power, flow = (
        user.get(name, _return_zero) for name in ("force", "energy", "stiffness", "power", "flow")
    )

    @compiled(inline=True)
    def add_forces(law: Any, workspace: Any, index: int, bed: Bed, time: float) -> int:
        state, constants = bed.state, bed.constants
        for i in range(constants.grains):
            fx, fy = force(law, make_grain(state, constants, i), time)
            state.fx[i] += value_or_one(law.species_factor, i) * fx
            state.fy[i] += value_or_one(law.species_factor, i) * fy
        return 0

    @compiled(inline=True)
    def measure_energy_and_stiffness(
        law: Any, workspace: Any, index: int, bed: Bed, time: float, slopes: Array, energies: Array
    ) -> int:
        state, constants, total = bed.state, bed.constants, 0.0
        for i in range(constants.grains):
            grain, factor = make_grain(state, constants, i), value_or_one(law.species_factor, i)
            total += factor * energy(law, grain, time)
            slopes[i] += abs(factor * stiffness(law, grain, time)) / grain.mass
        energies[index] = total
        return 0

    @compiled(inline=True)
    def record_external_work(law: Any, workspace: Any, index: int, dt: float, bed: Bed, time: float) -> int:
        state, constants, total = bed.state, bed.constants, 0.0
        for i in range(constants.grains):
            grain = make_grain(state, constants, i)
            total += value_or_one(law.species_factor, i) * power(law, grain, time)
        state.ledger[WORK] += dt * total
        return 0

    @compiled(inline=True)
    def damp_velocities(law: Any, workspace: Any, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        state, constants, lost = bed.state, bed.constants, 0.0
        for i in range(constants.grains):
            grain, vx, vy = make_grain(state, constants, i), state.vx[i], state.vy[i]
            wx, wy = flow(law, grain, vx, vy, dt)
            state.vx[i], state.vy[i] = wx, wy
            lost += 0.5 * grain.mass * ((vx - wx) * (vx + wx) + (vy - wy) * (vy + wy))
        state.ledger[LOSSES + index] += lost
        return 0

    hooks = (add_forces, measure_energy_and_stiffness, record_external_work, damp_velocities)
    return {_HOOKS[name]: hook for name, hook in zip(_HOOKS, hooks, strict=True) if name in user}


class CustomEffectLaw(CustomLaw):
    """Base class of the laws of custom effects."""

    # Factor of each grain's energy and force.
    extra_fields: ClassVar[Mapping[str, Any]] = {"species_factor": None}

    @staticmethod
    def hook_names(names: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the hooks of a law, from the names of its functions."""
        return tuple(_HOOKS[name] for name in names if name in _HOOKS)

    make_hooks = staticmethod(_make_grain_hooks)


NEAREST, FARTHEST = 1e-4, 1e3
"""Range of distances from a wall [D] in which to search for a grain's turning point."""


class CustomWallLaw(CustomLaw):
    """Base class of the laws of custom walls; three hooks are the user's functions."""

    @staticmethod
    def hook_names(names: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the hooks."""
        return (*names, "turning_point_stiffness")

    @staticmethod
    def make_hooks(user: Functions) -> Functions:
        """Make the hooks from the user's compiled functions, by name."""
        energy, stiffness = user["energy"], user["stiffness"]

        @compiled
        def turning_point_stiffness(law: Any, speed: float) -> float:
            near, far = math.log(NEAREST), math.log(FARTHEST)
            # log(1e3/1e-4)/2^60 is below the rounding of the logarithm.
            for _ in range(60):
                middle = 0.5 * (near + far)
                if energy(law, math.exp(middle)) > 0.5 * speed * speed:
                    near = middle
                else:
                    far = middle
            return abs(stiffness(law, math.exp(near)))

        return {**user, "turning_point_stiffness": turning_point_stiffness}
