"""Laws of motion: declared with an equation as text, or made from the text alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular import formulas
from granular.shared.errors import InputError, quote
from reduced_models.laws.equation import (
    TIME_OR_OBSERVATION,
    ParsedEquation,
    parse_equation,
    parse_law_formulas,
)

if TYPE_CHECKING:
    import sympy

    from reduced_models.records.first_guesses import FirstGuesses


class HeightLine(NamedTuple):
    """height = shift + scale z."""

    shift: float = 0.0  # height at z = 0 [m, rad]
    scale: float = 1.0  # height per unit of z, in the same unit; not zero

    @property
    def text(self) -> str:
        """The linear relation of height to z, as an equation in the text of a law."""
        return f"height = {self.shift!r} + {self.scale!r}*z"

    def coordinate(self, height: Any) -> Any:
        """Return the coordinate z at a height, or at an array of heights."""
        return (height - self.shift) / self.scale

    def height(self, z: Any) -> Any:
        """Return the height at a coordinate z, or at an array of coordinates."""
        return self.shift + self.scale * z


Starts = Callable[["FirstGuesses", np.random.Generator, int], dict[str, np.ndarray]]

_STEPS_OF_STROKE = 16
"""Number of steps per period along a stroke, relative to a smooth law of motion. With this number the piston
moves by 1/40 of half the stroke in a step; hysteresis that builds up over 1/20 of half the stroke is stable.
"""


@dataclasses.dataclass(frozen=True)
class Law:
    """A law with parameters: equations of its states and of the observed signals.

    Most equations are parsed when the law is first used; see Raises.

    Attributes
    ----------
    name : str
        Name under which the law is listed.
    equation : str
        Equation of motion such as ``"z'' + 2*lam*z' + omega**2*z = g0"``, linear in ``z''``. A law
        with memory has hidden states, which start at zero; each has an equation after a semicolon:
        ``"z'' + k*z + f*w = 0; w' = r*z' - r*Abs(z')*w"``. A name alone on the left is an observed
        column of the record: ``"z'' + k*z = 0; acceleration = gain*z'' + offset"``. Without such an
        equation, the height is the coordinate. Without an equation of motion the record prescribes the
        stroke, z, as on a dynamometer: ``"force = c*z' + k*z + zero"``. Two coordinates have two
        equations of motion, and a further equation gives the height:
        ``"m*x'' = k*(y - x); y'' = k*(x - y); height = x"``.
        The height of a dimensionless coordinate is given by ``"...; height = shift + scale*z"``.
    start : callable or None
        Function ``start(guesses, random, count)`` that returns random start values, an array of
        ``count`` values for each parameter. None: start values are estimated from the accelerations
        in the record.
    positive : tuple of str
        Positive parameters, which are searched on a logarithmic scale.
    units : mapping of str to str
        SI units of the parameters, for printed results; omitted parameters are printed without unit.
    source : str
        References for the law, as text; may be empty.
    inputs : tuple of str
        Names in the equation that are columns of the record, such as the motion of a base or a
        force; they are known functions of time, in the units of the columns. The time since the
        start, ``t``, and the ``z``, ``z'``, ``z''`` of a prescribed stroke are inputs if they occur.
    given : str
        Parameter that is held at the mean height of a prescribed stroke [m], unless a fit gives it
        another value or bounds; may be empty.
    resolution : int
        Number of steps per period that a solution needs, relative to a smooth law.

    Raises
    ------
    InputError
        If the equation cannot be read and contains ``t`` or an observation; other equations raise the error
        when the law is first used.

    Examples
    --------
    >>> from reduced_models import Law
    >>> law = Law("my-spring", "z'' + 2*lam*z' + k*(z - rest)**3 = 0", positive=("lam", "k"))
    >>> law.parameters
    ('lam', 'k', 'rest')
    """

    name: str
    equation: str
    start: Starts | None = None
    positive: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    source: str = ""
    inputs: tuple[str, ...] = ()
    resolution: int = 1
    given: str = ""

    def __post_init__(self) -> None:
        # The time and a prescribed stroke are inputs that every record has.
        if TIME_OR_OBSERVATION.search(self.equation):
            object.__setattr__(self, "inputs", self.parsed_equation.inputs)

    @property
    def literature(self) -> tuple[str, ...]:
        """References for the law, for `granular.cite`: a tuple with its ``source``."""
        return (self.source,)

    @property
    def parsed_equation(self) -> ParsedEquation:
        """The equation as SymPy expressions and names.

        Raises `InputError` if the equation cannot be read, is not linear in z'', or lacks an input.
        """
        return parse_equation(self.equation, self.inputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the equation.

        Inputs, hidden states and the time ``t`` are not parameters. Raises `InputError` as
        `parsed_equation` does.
        """
        return self.parsed_equation.parameters

    @property
    def prescribed(self) -> bool:
        """True if the record prescribes the motion; raises `InputError` as `parsed_equation` does."""
        return self.parsed_equation.acceleration is None

    @property
    def observations(self) -> tuple[str, ...]:
        """Names of the columns that the law observes; raises `InputError` as `parsed_equation` does.

        The tuple is empty if only the height is observed and the height is the coordinate or linear in
        the coordinate.
        """
        result = tuple(self.parsed_equation.observations)
        return () if result == ("height",) and self.observes_height else result

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden states, in the order of their equations.

        Raises
        ------
        InputError
            If the equation cannot be read, is not linear in z'', or does not contain one of the
            ``inputs``.
        """
        return tuple(self.parsed_equation.hidden)

    @property
    def observes_height(self) -> bool:
        """True if the height determines the coordinate; otherwise the coordinate's origin is arbitrary."""
        parsed = self.parsed_equation
        return not parsed.observations or parsed.observations.get("height") == parsed.symbol_z

    def height_line(self, values: Mapping[str, float]) -> HeightLine:
        """Return the linear function from the coordinate in the equation to the height.

        Parameters
        ----------
        values : mapping of str to float
            Values of all parameters, in the units of ``units``.

        Returns
        -------
        HeightLine
            Height [m] at z = 0, and change of the height per unit of z; 0 and 1 if the equation does not
            give them.

        Raises
        ------
        InputError
            If the equation cannot be read, is not linear in z'', or lacks one of the inputs.
        KeyError
            If a parameter of the linear function has no value.
        """
        line = self.parsed_equation.line
        if line is None:
            return HeightLine()
        shift, scale = (
            float(item.subs({symbol: values[symbol.name] for symbol in item.free_symbols})) for item in line
        )
        return HeightLine(shift, scale)

    @property
    def other_coordinates(self) -> tuple[str, ...]:
        """Hidden states that are further coordinates or their velocities; their initial values are free."""
        hidden = self.hidden
        return tuple(
            state for name in hidden if f"{name}_first" in hidden for state in (name, f"{name}_first")
        )

    @property
    def step_ratio(self) -> int:
        """Number of steps per period that a solution needs, relative to a smooth law.

        More steps are needed with several coordinates, which may oscillate faster than the first, and along
        a prescribed stroke, where hidden states respond within a fraction of the stroke.
        """
        steps_by_states = _STEPS_OF_STROKE if self.prescribed else 1 + len(self.other_coordinates) // 2
        return self.resolution * steps_by_states

    @property
    def acceleration(self) -> sympy.Expr:
        """Acceleration z'' in the symbols z, z_first (for z'), hidden states, inputs and parameters.

        It is in m/s^2; z is the height [m] even if the equation has another coordinate (see
        `height_line`).

        Raises
        ------
        InputError
            If the equation cannot be read, is not linear in z'', or does not contain one of the
            ``inputs``, or if the record prescribes the motion.
        """
        if self.prescribed:
            raise InputError(
                f"the law {quote(self.name)} has no z'', since a record prescribes the motion; use a "
                "law of motion"
            )
        return self.parsed_equation.acceleration

    def sympy_equation(self, values: Mapping[str, float] | None = None) -> sympy.Eq:
        """Return the equation in z(t), with the numbers in ``values``.

        Hidden states stay symbols; `sympy_hidden` has their equations.

        Parameters
        ----------
        values : mapping of str to float, optional
            Values of parameters, in the units of ``units``; the others stay symbols. Names that are not
            in the equation are ignored.

        Returns
        -------
        sympy.Eq
            Equation as written, not solved for z''; for a prescribed stroke, the equation of the first
            observation.

        Raises
        ------
        InputError
            If the equation cannot be read, is not linear in z'', or lacks one of the inputs.
        """
        import sympy

        parsed = self.parsed_equation
        t = sympy.Symbol("t")
        z = sympy.Function("z")(t)
        numbers = {sympy.Symbol(name): number for name, number in (values or {}).items()}
        both = (parsed.left, parsed.right)
        if parsed.acceleration is None:
            name, value = next(iter(parsed.observations.items()))
            both = (sympy.Symbol(name), value)
        sides = [
            side.subs(numbers).subs(
                {parsed.symbol_a: z.diff(t, 2), parsed.symbol_v: z.diff(t), parsed.symbol_z: z}
            )
            for side in both
        ]
        return sympy.Eq(*sides, evaluate=False)

    def sympy_hidden(self, values: Mapping[str, float] | None = None) -> dict[str, sympy.Expr]:
        """Return the rate of each hidden state as a function of z(t), z'(t), hidden states and inputs.

        Parameters
        ----------
        values : mapping of str to float, optional
            Values of parameters, in the units of ``units``; the others stay symbols. Names that are not
            in the equation are ignored.

        Returns
        -------
        dict of str to sympy.Expr
            Rate [unit of the state per s] of each hidden state by name; empty if there are none.

        Raises
        ------
        InputError
            If the equation cannot be read, is not linear in z'', or lacks one of the inputs.
        """
        import sympy

        parsed, t = self.parsed_equation, sympy.Symbol("t")
        z = sympy.Function("z")(t)
        numbers = {sympy.Symbol(name): number for name, number in (values or {}).items()}
        motion = {parsed.symbol_v: z.diff(t), parsed.symbol_z: z}
        return {name: rate.subs(numbers).subs(motion) for name, rate in parsed.written.items()}


def law_from_text(equation: str, columns: Collection[str] = (), declared: Collection[str] = ()) -> Law:
    """Make a law from its equation alone; names that are columns of the record become inputs."""
    # An undeclared name that looks like a column or a constant is refused, since a typing error would become
    # a parameter.
    trees = parse_law_formulas(equation)
    law = f"the law {quote(equation)}"
    for name in formulas.constant_names(*trees.all_trees):
        if name in columns:
            raise InputError(
                f"{law} contains {name}, which is a number in equations, but the record has a column of "
                "that name; rename the column"
            )
    inputs = tuple(name for name in trees.names if name in columns and name != "z")
    result = Law(name=" ".join(equation.split()), equation=equation, inputs=inputs)
    for name in result.parameters:
        if name not in declared:
            refuse_suspicious_parameter_name(law, name, columns)
    if not result.parameters:
        raise InputError(f"{law} has no parameter to fit; write a name for a number that is unknown")
    return result


_MOTION = {
    "height": "z",
    "displacement": "z",
    "velocity": "z'",
    "speed": "z'",
    "acceleration": "z''",
    "time": "t",
}
_COLUMNS = (
    "force",
    "input",
    "drive",
    "load",
    "excitation",
    "voltage",
    "current",
    "temperature",
    "pressure",
    "torque",
)
_NUMBERS = ("pi", "e", "inf", "nan", "infinity")


def refuse_suspicious_parameter_name(law: str, name: str, columns: Collection[str]) -> None:
    """Raise an error for a parameter whose name suggests a column, a derivative or a constant."""
    lower, near = name.lower(), {column.lower(): column for column in columns}
    declare = f"or declare the parameter, parameters={{{name!r}: ...}}"
    if lower in near:
        raise InputError(
            f"{law} contains {name}, but the record has a column {near[lower]!r}; write that name, {declare}"
        )
    if name in _MOTION:
        raise InputError(f"{law} contains {name}; write {_MOTION[name]} instead, {declare}")
    if lower in _COLUMNS:
        known_columns = ", ".join(map(repr, columns)) or "none"
        raise InputError(
            f"{law} contains {name}, which looks like a column, but the columns of the record are: "
            f"{known_columns}; add the column, {declare}"
        )
    if lower in _NUMBERS and len(name) > 1:
        raise InputError(
            f"{law} contains {name}, which looks like a number; write pi or e instead, {declare}"
        )
