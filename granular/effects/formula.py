"""Energies that are written as formulas, and what is derived from them.

A text is read by `granular.formulas`, never run. Its names are variables, which the kind of
formula fixes, and parameters, which stand next to it with their units; the units must make joules.
Force, stiffness and the rate of change in time are derived from it, so that the force is minus the
gradient of the energy.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numba

from granular.compiled.hook_calls import OPTIONS
from granular.effects.custom_functions import DEFINITIONS, CustomDefinition
from granular.effects.effect import Effect
from granular.effects.force_effect import ForceEffect
from granular.formulas import parse
from granular.schema.field_kinds import FieldError
from granular.schema.formula_parameters import SectionWithFormula
from granular.schema.natural_units import Scales
from granular.schema.sections import text_field
from granular.shared.errors import InputError
from granular.shared.message_text import quote

if TYPE_CHECKING:
    import sympy

    from granular.schema.apparatus import Cell, Grains, Piston

Functions = dict[str, Callable[..., Any]]

_FORM = "2"
"""Part of the digest, to be raised with any change of what is derived from a text."""


class EnergyFormula(SectionWithFormula):
    """An energy as a formula.

    Attributes
    ----------
    energy : str
        [J]
    """

    formula_key: ClassVar[str] = "energy"
    unit: ClassVar[str] = "J"

    energy: str = text_field()

    @staticmethod
    def derivative_expressions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive SymPy's expressions of force and stiffness from that of the energy."""
        raise NotImplementedError

    @staticmethod
    def make_kernel_functions(compiled: Functions) -> Functions:
        """Make the functions that kernels call, from compiled ones of all variables and parameters."""
        raise NotImplementedError

    @classmethod
    def kernel_function_names(cls, energy: str) -> tuple[str, ...]:
        """Names of the functions that kernels get from a formula."""
        raise NotImplementedError

    def parameters_in_natural_units(self, scales: Scales) -> tuple[float, ...]:
        """Parameters in natural units, in the order of `values`."""
        units = (scales.length, scales.mass, scales.time, scales.current)
        result = []
        for name, _ in self.values:
            value, dimension = self.parameter_value_and_dimension(name)
            for unit, power in zip(units, dimension, strict=True):
                value /= unit ** float(power)
            result.append(value)
        return tuple(result)

    @property
    def definition(self) -> CustomDefinition:
        """Definition by which kernels know the formula."""
        kind: Any = type(self)
        result: CustomDefinition = _make_definition(kind, self.energy, tuple(name for name, _ in self.values))
        DEFINITIONS[result.digest] = result
        return result

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest of what is derived, for the run's settings."""
        return (self.definition.digest,)


class FormulaList(ForceEffect):
    """Base of an effect that a scene gives as a list of tables, or as one table."""

    if TYPE_CHECKING:
        fields: tuple[Any, ...]

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Read a list of tables, or one table; diameter [m]."""
        tables = [plain] if isinstance(plain, Mapping) else plain
        try:
            return super().from_plain({"fields": tables}, diameter)
        except FieldError as error:
            raise FieldError(error.reason, *error.path[1:]) from None

    def to_plain(self) -> Any:
        """Formulas as a list of tables; `from_plain` makes an equal effect of it."""
        return [part.to_plain() for part in self.component_effects]

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """The formulas, each an effect with a law of its own, (k,)."""
        return self.fields

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check each formula; see `Effect.check_compatibility`."""
        for part in self.component_effects:
            part.check_compatibility(grains, cell, piston, others)


@functools.cache
def _make_definition(kind: type[EnergyFormula], energy: str, parameters: tuple[str, ...]) -> CustomDefinition:
    key = kind.__name__.lower()
    content = repr((_FORM, key, energy, parameters))
    digest = hashlib.sha256(content.encode()).hexdigest()[:24]
    functions = _DerivedFunctions(kind, energy, parameters)
    return CustomDefinition(
        "effect", key, f"{key}_{digest}", _pack_values, functions, _CompiledFunctions(functions)
    )


def _pack_values(*values: float) -> tuple[float, ...]:
    return values


if not numba.config.DISABLE_JIT:
    _pack_values = numba.njit(**OPTIONS)(_pack_values)


class _DerivedFunctions(Mapping[str, Callable[..., Any]]):
    """The functions of a formula, derived when one of them is asked for first."""

    def __init__(self, kind: type[EnergyFormula], energy: str, parameters: Sequence[str]) -> None:
        self.kind, self.energy, self.parameters = kind, energy, parameters
        self.known = kind.kernel_function_names(energy)

    def __iter__(self) -> Iterator[str]:
        return iter(self.known)

    def __len__(self) -> int:
        return len(self.known)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        if name not in self.known:
            raise KeyError(name)
        return self._derived_kernel_functions[name]

    @functools.cached_property
    def _derived_kernel_functions(self) -> Functions:
        import sympy

        from granular.formulas.algebra import compile_function, sympy_expression

        symbols = {name: sympy.Symbol(name, real=True) for name in self.kind.variables}
        given = {
            name: sympy.Symbol(f"parameter{index}", real=True) for index, name in enumerate(self.parameters)
        }
        tree = sympy_expression(parse(self.energy), symbols | given)
        forms = self.kind.derivative_expressions(tree, symbols)
        # Of sign(u/a), where a may be zero, SymPy leaves the derivative as it is.
        if forms["force"].has(sympy.DiracDelta, sympy.Derivative):
            raise InputError(f"the energy {quote(self.energy)} jumps; write one without jumps")
        arguments = [*symbols.values(), *given.values()]
        made = {
            name: compile_function(arguments, _remove_delta_of_kink(form)) for name, form in forms.items()
        }
        if not numba.config.DISABLE_JIT:
            made = {name: numba.njit(**OPTIONS)(function) for name, function in made.items()}
        return self.kind.make_kernel_functions(made)


def _remove_delta_of_kink(form: sympy.Expr) -> sympy.Expr:
    """Without the infinite stiffness of a kink, at the one point where it is."""
    import sympy

    for infinite in (sympy.DiracDelta, sympy.Derivative):
        form = form.replace(infinite, lambda *_: sympy.Integer(0))
    return form.replace(sympy.Heaviside, lambda x, *_: (1 + sympy.sign(x)) / 2)


class _CompiledFunctions(Mapping[str, Callable[..., Any]]):
    """The same, to be called by kernels."""

    def __init__(self, functions: _DerivedFunctions) -> None:
        self.functions = functions

    def __iter__(self) -> Iterator[str]:
        return iter(self.functions)

    def __len__(self) -> int:
        return len(self.functions)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        return numba.njit(**OPTIONS)(self.functions[name])
