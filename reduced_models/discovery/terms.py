"""The terms of discovered equations, their texts, and hidden states of a bed.

Each hidden state is a strain w of the bed that is zero at the start of the record: the logarithmic strain
(-dz/z, positive in compression) minus its losses by yielding or relaxation. Its scale is the yield
strain or the relaxation time. The equations

    yielding:  w' = -(z' + |z'| |w| w/yield^2)/z
    Dahl:      w' = -(z' + |z'| w/yield)/z            (Dahl 1968: yields already at small strains)
    relaxing:  w' = -z'/z - w/relaxation              (Maxwell element with one relaxation time)

are solved exactly from sample to sample for a strain rate z'/z that is constant between samples.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular import formulas
from granular.formulas import algebra
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy


INPUT = "u"


def state_symbols() -> tuple[sympy.Symbol, sympy.Symbol, sympy.Symbol]:
    """Return the real symbols z, v (for z') and u (for the input)."""
    import sympy

    z, v, u = (sympy.Symbol(name, real=True) for name in ("z", "v", INPUT))
    return z, v, u


def motion_symbols() -> tuple[sympy.Symbol, ...]:
    """Return the symbols of `state_symbols`, and t for the time since the start."""
    import sympy

    return (*state_symbols(), sympy.Symbol(TIME, real=True))


def expression_text(expression: sympy.Expr) -> str:
    """Write an expression in the notation of laws, with z' for v."""
    return re.sub(r"\bv\b", "z'", str(expression))


_LARGEST_DENOMINATOR = 100  # largest denominator of numbers printed as fractions


def round_fractions_for_print(expression: sympy.Expr) -> sympy.Expr:
    """Round fractions with large denominators to five-digit numbers, for printing."""
    import sympy

    fractions = expression.atoms(sympy.Rational)
    return expression.xreplace(
        {item: sympy.Float(item, 5) for item in fractions if item.q > _LARGEST_DENOMINATOR}
    )


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)  # quadrature that is exact up to degree 9


class TermArguments(NamedTuple):
    """Arguments of terms along a motion."""

    z: Float[np.ndarray, "n"]
    v: Float[np.ndarray, "n"]  # z'
    u: Float[np.ndarray, "n"] | None = None  # the input
    t: Float[np.ndarray, "n"] | None = None  # time since the start


@dataclasses.dataclass(frozen=True)
class CustomTerm:
    """Term such as sin(z): a function of z, z', input and time that is not a product of powers."""

    expression: sympy.Expr

    @functools.cached_property
    def text(self) -> str:
        """Text of the term in the notation of laws, such as "sin(z)"."""
        return expression_text(round_fractions_for_print(self.expression))

    @property
    def has_input(self) -> bool:
        """True if the term contains the input."""
        return bool(self.expression.has(state_symbols()[2]))

    @property
    def is_speed_independent(self) -> bool:
        """True for a term of z (and the input) alone, without z'."""
        return not self.expression.has(state_symbols()[1])

    @property
    def varies_with_speed(self) -> bool:
        """True if the term depends on the velocity z'."""
        return not self.is_speed_independent

    @property
    def is_total_derivative(self) -> bool:
        """True for a term G'(z) z', the rate of a function G of z."""
        return self._height_factor is not None

    @functools.cached_property
    def _height_factor(self) -> sympy.Expr | None:
        """Factor G'(z) of a term G'(z) z'; None for other terms."""
        import sympy

        if self.is_speed_independent:
            return None
        _, v, *others = motion_symbols()
        factor = sympy.cancel(self.expression / v)
        return None if factor.has(v, *others) else factor

    def values(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Return the values of the term at samples."""
        return evaluate_expression(self.expression, state)

    def antiderivative(self, z: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Antiderivative G(z) of a term G'(z) z' = dG/dt, zero at the lowest z."""
        # By quadrature: many antiderivatives have no closed form, or one that takes minutes to find.
        order = np.argsort(z)
        steps = np.diff(z[order], prepend=z[order[:1]])
        nodes = z[order, None] + steps[:, None] * (_NODES - 1.0) / 2.0
        areas = steps * (self.height_factor(nodes) @ _WEIGHTS) / 2.0
        areas_below = np.empty(len(z))
        areas_below[order] = np.cumsum(areas)
        return areas_below

    def height_factor(self, z: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Factor G'(z) of a term G'(z) z'."""
        return evaluate_expression(self._height_factor, TermArguments(z, z))

    def derivative_by_height(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Compute the derivative with respect to z at samples, without delta functions at jumps."""
        return evaluate_expression(_term_derivative(self.expression, 0), state)

    def derivative_by_speed(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Compute the derivative with respect to z' at samples, without delta functions at jumps."""
        return evaluate_expression(_term_derivative(self.expression, 1), state)


def _sort_operands(extreme: sympy.Expr) -> sympy.Expr:
    """Rewrite a nested maximum or minimum with distinct operands in canonical order."""
    from sympy import default_sort_key

    pair = type(extreme)
    operands, open_ones = set(), list(extreme.args)
    while open_ones:
        item = open_ones.pop()
        if type(item) is pair:
            open_ones += item.args
        else:
            operands.add(item)
    return functools.reduce(pair, sorted(operands, key=default_sort_key))


def parse_term_expressions(
    texts: Sequence[str], column: str | None = None, numbers: Sequence[str] = ()
) -> list[sympy.Expr]:
    """Parse users' terms in z, z', t and the input's column."""
    return [_parse_term(text, column, numbers) for text in texts]


def _parse_term(text: str, column: str | None, numbers: Sequence[str]) -> sympy.Expr:
    import sympy

    z, v, u = state_symbols()
    named = {name: sympy.Symbol(name) for name in numbers} | {"z": z, "z'": v, TIME: motion_symbols()[3]}
    if column is not None:
        named |= {INPUT: u, column: u}
    term = f"the term {quote(text)}"
    try:
        tree = formulas.parse(text)
        strange = [name.text for name in formulas.variable_names(tree) if name.text not in named]
        if strange:
            known = "z, z', t and the input's column" if column is None else f"z, z', t, u and {column}"
            more = "; give the input's column by input=" if column is None else ""
            raise InputError(f"{term} contains {strange[0]}; terms are functions of {known}{more}")
        formula = algebra.sympy_expression(tree, named)
    except formulas.FormulaError as error:
        raise InputError(f"{term} cannot be read: {error}") from None
    exact = formula.xreplace({atom: sympy.Rational(str(atom)) for atom in formula.atoms(sympy.Float)})
    if exact == 0:
        raise InputError(f"{term} is zero; remove it")
    return exact


def _term_derivative(expression: sympy.Expr, index: int) -> sympy.Expr:
    """Return the derivative with respect to z (index 0) or z' (1), without delta functions at jumps."""
    import sympy

    return sympy.diff(expression, state_symbols()[index]).replace(
        sympy.DiracDelta, lambda *_: sympy.Integer(0)
    )


@functools.lru_cache(maxsize=256)
def _compiled_expression(expression: sympy.Expr) -> Callable[..., Any]:
    return algebra.compile_expressions(motion_symbols(), expression)


def evaluate_expression(expression: sympy.Expr, state: TermArguments) -> Float[np.ndarray, "n"]:
    """Evaluate an expression in the symbols of `motion_symbols` at samples."""
    with np.errstate(all="ignore"):
        values = _compiled_expression(expression)(*(0.0 if value is None else value for value in state))
    return np.broadcast_to(np.asarray(values, dtype=np.float64), state.z.shape)


class Term(NamedTuple):
    """Term z^power |z'|^speed, times sign(z') if ``odd``, times the input if ``has_input``."""

    power: int
    speed: int = 0
    odd: bool = False
    has_input: bool = False

    @property
    def is_speed_independent(self) -> bool:
        """True for a term of z (and the input) alone, without z'."""
        return self.speed == 0 and not self.odd

    @property
    def is_total_derivative(self) -> bool:
        """True for z^a z', the rate of z^(a+1)/(a+1)."""
        return self.speed == 1 and self.odd and not self.has_input

    @property
    def varies_with_speed(self) -> bool:
        """True if the term depends on the speed and not only on its sign."""
        return self.speed > 0

    @property
    def text(self) -> str:
        """Text of the term in the notation of laws, such as "z**2*z'"."""
        return expression_text(self.expression)

    @property
    def expression(self) -> sympy.Expr:
        """Term as a sympy.Expr in the symbols of `state_symbols`."""
        import sympy

        z, v, u = state_symbols()
        if self.odd:
            motion = sympy.sign(v) if self.speed == 0 else v * sympy.Abs(v) ** (self.speed - 1)
        else:
            motion = sympy.Abs(v) ** self.speed
        return z**self.power * motion * (u if self.has_input else 1)

    def values(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Return the values of the term at samples."""
        product = state.z**self.power * np.abs(state.v) ** self.speed
        if self.odd:
            product = product * np.sign(state.v)
        return self._multiply_by_input(product, state)

    def _multiply_by_input(self, product: np.ndarray, state: TermArguments) -> np.ndarray:
        return product * state.u if self.has_input and state.u is not None else product

    def antiderivative(self, z: np.ndarray) -> np.ndarray:
        """Antiderivative z^(power + 1)/(power + 1) at samples of z (n,): float64 (n,)."""
        return z ** (self.power + 1) / (self.power + 1)

    def height_factor(self, z: np.ndarray) -> np.ndarray:
        """Factor z^power of a term z^power z' at samples of z (n,): float64 (n,)."""
        return np.asarray(z**self.power)

    def derivative_by_height(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Compute the derivative of the term with respect to z at samples."""
        if not self.power:
            return np.zeros_like(state.z)
        return self.power * self._replace(power=self.power - 1).values(state)

    def derivative_by_speed(self, state: TermArguments) -> Float[np.ndarray, "n"]:
        """Compute the derivative of the term with respect to z' at samples."""
        sign = 1.0 if self.odd else np.sign(state.v)
        product = state.z**self.power * self.speed * np.abs(state.v) ** (self.speed - 1) * sign
        return self._multiply_by_input(product, state)


AnyTerm = Term | CustomTerm


def sort_terms(terms: Iterable[AnyTerm]) -> list[AnyTerm]:
    """Sort terms into a fixed order: products of powers first, then custom terms by their texts."""
    return sorted(terms, key=lambda term: (1, term.text) if isinstance(term, CustomTerm) else (0, *term))


@functools.cache
def physical_library_terms(degree: int, has_input: bool = False) -> tuple[Term, ...]:
    """Return the physical library: powers of z up to ``degree``, times 1, z', |z'| z' and sign(z')."""
    factors = ((0, False), (1, True), (2, True), (0, True))
    terms = tuple(Term(power, *factor) for factor in factors for power in range(degree + 1))
    return (*terms, Term(0, has_input=True)) if has_input else terms


def terms_with_coefficients(expression: sympy.Expr) -> dict[AnyTerm, float] | None:
    """Return the terms of a sum with their coefficients; None if the expression cannot be split."""
    import sympy

    coefficients: dict[AnyTerm, float] = {}
    # SymPy would expand a root of a sum, such as (z - d)**1.5, into a sum of roots.
    roots = {
        power: sympy.Dummy()
        for power in expression.atoms(sympy.Pow)
        if power.base.is_Add and not power.exp.is_Integer
    }
    restored = {root: power for power, root in roots.items()}
    for part in sympy.Add.make_args(sympy.expand(expression.xreplace(roots))):
        terms = _power_products_with_coefficients(part)
        if terms is None:
            coefficient, rest = part.xreplace(restored).as_independent(*motion_symbols(), as_Add=False)
            if not coefficient.is_real or not coefficient.is_number or rest.atoms(sympy.Float):
                return None
            if rest.free_symbols - set(motion_symbols()):
                return None
            sorted_rest = rest.replace(lambda item: type(item).__name__ in ("max", "min"), _sort_operands)
            terms = {CustomTerm(sorted_rest): float(coefficient)}
        for term, value in terms.items():
            coefficients[term] = coefficients.get(term, 0.0) + value
    return {term: value for term, value in coefficients.items() if value != 0.0}


def _power_products_with_coefficients(expression: sympy.Expr) -> dict[AnyTerm, float] | None:
    """Return the products of powers in an expression; None if it contains anything else."""
    import sympy

    z, v, u = state_symbols()
    modulus, sign = sympy.Symbol("modulus"), sympy.Symbol("sign")
    # The factor is split off because SymPy takes milliseconds to set up a field for each real coefficient.
    factor, plain = expression.subs({sympy.Abs(v): modulus, sympy.sign(v): sign}).as_coeff_Mul()
    try:
        polynomial = sympy.Poly(sympy.expand(plain), z, v, modulus, sign, u)
    except sympy.PolynomialError:
        return None
    coefficients: dict[AnyTerm, float] = {}
    for (power, first, second, signs, driven), coefficient in polynomial.terms():
        if not coefficient.is_number or not coefficient.is_real or driven > 1:
            return None
        odd = (first + signs) % 2 == 1
        # sign(z')^2 is 1 for a moving piston.
        term = Term(power, first + second, odd, bool(driven))
        coefficients[term] = coefficients.get(term, 0.0) + float(factor * coefficient)
    return coefficients


def linear_combination(terms: Sequence[AnyTerm], coefficients: Sequence[float]) -> sympy.Expr:
    """Return a linear combination of terms as an expression."""
    import sympy

    pairs = zip(terms, coefficients, strict=True)
    return sympy.Add(*(sympy.Float(value) * term.expression for term, value in pairs))


def expression_with_symbols_and_their_numbers(expression: sympy.Expr) -> tuple[sympy.Expr, dict[str, float]]:
    """Replace the numbers in an expression by symbols c0, c1, ...; return it and the numbers."""
    # Coefficients follow the order of the sorted terms, so that equal structures are one law, compiled once.
    import sympy

    terms = terms_with_coefficients(expression)
    if terms is not None:
        names = {f"c{k}": terms[term] for k, term in enumerate(sort_terms(terms))}
        parts = (
            sympy.Symbol(name) * term.expression for name, term in zip(names, sort_terms(terms), strict=True)
        )
        return sympy.Add(*parts), names
    floats = sorted(expression.atoms(sympy.Float), key=float)
    symbol_of = {item: sympy.Symbol(f"c{k}") for k, item in enumerate(floats)}
    return expression.xreplace(symbol_of), {symbol_of[item].name: float(item) for item in floats}


def structure_text(terms: Sequence[AnyTerm]) -> str:
    """Write a sum with a letter for each coefficient: "a*z' + b*sin(z)"."""
    parts = zip("abcdefghijklmnopqrstuvwxyz", terms, strict=False)
    return " + ".join(name if term.text == "1" else f"{name}*{term.text}" for name, term in parts)


def expression_node_count(expression: sympy.Expr) -> int:
    """Return the complexity of an expression: the number of nodes in its tree."""
    import sympy

    return sum(1 for _ in sympy.preorder_traversal(expression))


StateStep = Callable[[np.ndarray, float, float, np.ndarray], np.ndarray]
"""Function that advances a state by one step. Its arguments are the state (k,), the strain -d(log z) and the
duration of the step, and the scales (k,)."""
_NEAR_ONE = 1.0 - 1e-12


_STRAINS, _DISPLACEMENTS = np.geomspace(0.01, 1.0, 17)[:, None], np.geomspace(1e-5, 0.1, 33)[:, None]


class HiddenState(NamedTuple):
    """Kind of hidden state, with scales that are still unknown."""

    name: str
    rate_equations: str
    step: StateStep  # with three scales there are two states, the second multiplied by the third scale
    trial_scales: np.ndarray = _STRAINS  # (k, s), the first grid
    scales: tuple[str, ...] = ("yielding",)
    force_variable: str = "w"  # expression in the states that enters the terms
    in_periods: bool = False  # trial scales are times in periods of the motion
    of_displacement: bool = False  # the state is a displacement instead of a strain

    def values_along_motion(self, time: np.ndarray, height: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """Return the values (k, n) of the state along a motion, for each row of ``scales`` (k, s)."""
        # The logarithmic strain of these heights equals the displacement.
        heights = np.exp(-height) if self.of_displacement else height
        first = _integrate_hidden_states(self.step, time, heights, scales[:, 0])
        if scales.shape[1] == 1:
            return first
        return np.asarray(
            first + scales[:, 2:] * _integrate_hidden_states(self.step, time, heights, scales[:, 1])
        )

    def substitute_into(self, equation: str) -> str:
        """Replace the input in an equation by ``force_variable``, and append the rate equations."""
        forces = re.sub(rf"\b{INPUT}\b", self.force_variable, equation)
        return f"{forces}; {self.rate_equations}"


def _advance_yielding_state(state: np.ndarray, strain: float, _: float, scale: np.ndarray) -> np.ndarray:
    """Advance a state s by a strain step dx: ds = dx (1 - |s| s sign(dx)/e^2) with the yield strain e."""
    sign = 1.0 if strain >= 0.0 else -1.0
    along, distance = sign * state / scale, abs(strain) / scale
    since = np.where(
        along < 0.0, np.arctan(np.minimum(along, 0.0)), np.arctanh(np.clip(along, 0.0, _NEAR_ONE))
    )
    reached = since + distance
    return np.asarray(
        sign * scale * np.where(reached < 0.0, np.tan(np.minimum(reached, 0.0)), np.tanh(reached))
    )


def _advance_dahl_state(state: np.ndarray, strain: float, _: float, scale: np.ndarray) -> np.ndarray:
    end = scale if strain >= 0.0 else -scale
    return np.asarray(end + (state - end) * np.exp(-abs(strain) / scale))


def _advance_relaxing_state(state: np.ndarray, strain: float, step: float, scale: np.ndarray) -> np.ndarray:
    saved = step / scale
    return np.asarray(state * np.exp(-saved) - strain * np.expm1(-saved) / saved)


def _integrate_hidden_states(
    step: StateStep, time: np.ndarray, height: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return the values (k, n) of a state along a motion, for each value (k,) of its only scale."""
    strains, steps = -np.diff(np.log(height)), np.diff(time)
    values = np.zeros((len(time), len(scale)))
    for k, (strain, value) in enumerate(zip(strains.tolist(), steps.tolist(), strict=True)):
        values[k + 1] = step(values[k], strain, value, scale)
    return values.T


def _trial_strain_pairs_with_fractions() -> np.ndarray:
    strains = np.geomspace(0.01, 1.0, 6)
    pairs = [(a, b) for k, a in enumerate(strains) for b in strains[k + 1 :]]
    return np.array([(*pair, fraction) for pair in pairs for fraction in (0.5, 2.0)])


_YIELDING = "-(z' + Abs(z')*Abs({0})*{0}/{1}**2)/z"
HIDDEN_STATES = (
    HiddenState("yielding strain", "w' = " + _YIELDING.format("w", "yielding"), _advance_yielding_state),
    HiddenState(
        "strain that yields as in Dahl's model", "w' = -(z' + Abs(z')*w/yielding)/z", _advance_dahl_state
    ),
    HiddenState(
        "relaxing strain",
        "w' = -z'/z - w/relaxation",
        _advance_relaxing_state,
        np.geomspace(0.02, 20.0, 17)[:, None],
        ("relaxation",),
        in_periods=True,
    ),
    HiddenState(
        "two yielding strains",
        f"w' = {_YIELDING.format('w', 'yielding')}; q' = {_YIELDING.format('q', 'later')}",
        _advance_yielding_state,
        _trial_strain_pairs_with_fractions(),
        ("yielding", "later", "share"),
        "(w + share*q)",
    ),
)
DAMPER_STATES = (
    HiddenState(
        "displacement that yields",
        "w' = z' - Abs(z')*Abs(w)*w/yielding**2",
        _advance_yielding_state,
        _DISPLACEMENTS,
        of_displacement=True,
    ),
    HiddenState(
        "displacement that yields as in Dahl's model",
        "w' = z' - Abs(z')*w/yielding",
        _advance_dahl_state,
        _DISPLACEMENTS,
        of_displacement=True,
    ),
)
"""Hidden states [m] of a damper on a stroke about zero: Bouc-Wen and Dahl."""


class ScaledHiddenState(NamedTuple):
    """Hidden state with values of its scales."""

    kind: HiddenState
    scales: tuple[float, ...]

    def substitute_into(self, equation: str) -> str:
        """Replace the input by the hidden state; append its rate equations with the values of its scales."""
        text = self.kind.substitute_into(equation)
        for name, value in zip(self.kind.scales, self.scales, strict=True):
            text = re.sub(rf"\b{name}\b", f"{value:.4g}", text)
        return text
