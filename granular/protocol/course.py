"""A stage whose course in time is a formula, handed to the loop as a spline."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from granular.effects.parameters import Parametric
from granular.protocol.stage import Stage
from granular.scene.schema import FieldError
from granular.shared.grammar import parse
from granular.shared.messages import quoted

CLOSE = 1e-11
"""What the spline may be off by halfway between its knots, over the range of the course."""
LEAST_KNOTS, MOST_KNOTS = 64, 2**17


class Course(Parametric, Stage):
    """A stage with a formula of time."""

    @property
    def tabled(self) -> bool:
        return True

    def course(self, duration: float, height: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Knots (k,) [s], and the values and slopes there (2, k) in SI, from t = 0 to the end."""
        given = [self.parameter(name)[0] for name, _ in self.values]
        names_given = tuple(name for name, _ in self.values)
        value, slope = _functions(self.formula, tuple(self.variables), names_given)
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
