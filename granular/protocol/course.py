"""A stage whose course in time is a formula, handed to the loop as a spline."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import numpy as np

from granular.effects.dimensions import Dimension, dimension_of, unit_text
from granular.effects.formula import Values, value_and_dimension
from granular.protocol.stage import Stage
from granular.scene.schema import FieldError, declare, unknown
from granular.shared.errors import InputError
from granular.shared.grammar import names, parse
from granular.shared.messages import quoted

CLOSE = 1e-11
"""What the spline may be off by halfway between its knots, over the range of the course."""
LEAST_KNOTS, MOST_KNOTS = 64, 2**17


class Course(Stage):
    """A stage with a formula of time.

    Attributes
    ----------
    values : pairs of str
        The formula's parameters, each with its number and SI unit; in a scene they stand beside it.
    """

    variables: ClassVar[Mapping[str, Dimension]] = {}
    written: ClassVar[str] = ""
    dimension: ClassVar[Dimension] = ()

    values: tuple[tuple[str, str], ...] = declare(Values(), default=())

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        if isinstance(plain, Mapping) and "values" not in plain:
            known = {name: plain[name] for name in plain if name in cls.key_names()}
            plain = known | {"values": {name: plain[name] for name in plain if name not in known}}
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        plain = super().to_plain()
        del plain["values"]
        return plain | dict(self.values)

    def validate(self) -> None:
        try:
            tree, given = parse(self._formula), dict(self.values)
            for name in names(tree):
                if name.text not in self.variables and name.text not in given:
                    known = (*self.variables, *given)
                    raise InputError(f"{unknown(name.text, known, 'name')}; or give it beside")
            used = {one.text for one in names(tree)}
            for key in given:
                if key in self.variables or key not in used:
                    raise FieldError(f"the formula has no parameter {quoted(key)}", key)
            dimensions = {name: value_and_dimension(text)[1] for name, text in self.values}
            found = dimension_of(tree, dict(self.variables) | dimensions)
            if found != self.dimension:
                raise InputError(
                    f"it is in {unit_text(found)}, not in {unit_text(self.dimension)}; check the "
                    "units"
                )
        except FieldError:
            raise
        except InputError as error:
            raise FieldError(str(error), self.written) from None

    @property
    def _formula(self) -> str:
        formula: str = getattr(self, self.written)
        return formula

    def course(self, duration: float, height: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Knots (k,) [s], and the values and slopes there (2, k) in SI, from t = 0 to the end."""
        given = [value_and_dimension(text)[0] for _, text in self.values]
        names_given = tuple(name for name, _ in self.values)
        value, slope = _functions(self._formula, tuple(self.variables), names_given)
        start = [] if height is None else [height]

        def at(times: np.ndarray) -> np.ndarray:
            with np.errstate(all="ignore"):
                found = [np.broadcast_to(of(times, *start, *given), times.shape)
                         for of in (value, slope)]  # fmt: skip
            return np.array(found, dtype=np.float64)

        count = LEAST_KNOTS
        while True:
            times = np.linspace(0.0, duration, count + 1)
            knots = at(times)
            if not np.isfinite(knots).all():
                raise FieldError("is not finite everywhere in the stage", self.written)
            h = duration / count
            middle = (knots[0, 1:] + knots[0, :-1]) / 2 + h * (knots[1, :-1] - knots[1, 1:]) / 8
            off = np.abs(middle - at((times[1:] + times[:-1]) / 2)[0]).max()
            if off <= CLOSE * max(np.ptp(knots[0]), np.abs(knots[0]).max()):
                return times, knots
            count *= 2
            if count > MOST_KNOTS:
                raise FieldError(
                    "changes too fast, or is not smooth; write it smoother", self.written
                )


@functools.cache
def _functions(
    formula: str, variables: tuple[str, ...], parameters: tuple[str, ...]
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    import sympy

    from granular.shared.algebra import expression, function_of

    symbols = {name: sympy.Symbol(name, real=True) for name in variables}
    given = {
        name: sympy.Symbol(f"parameter{place}", real=True) for place, name in enumerate(parameters)
    }
    tree = expression(parse(formula), symbols | given)
    arguments = [*symbols.values(), *given.values()]
    slope = tree.diff(symbols["t"])
    if slope.has(sympy.DiracDelta):
        raise FieldError(f"{quoted(formula)} jumps; write it without jumps")
    return function_of(arguments, tree), function_of(arguments, slope)
