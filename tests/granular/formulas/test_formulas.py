"""The grammar of formulas: accepted and refused texts. Formulas are never run as Python code."""

import math

import numpy as np
import pytest

from granular import formulas
from granular.formulas import FormulaError, Name, Number, Operation, parse
from granular.formulas.algebra import compile_expressions, sympy_expression


def value(text: str, **given: float) -> float:
    """Return the value of a formula, computed by SymPy and NumPy."""
    import sympy

    symbols = [sympy.Symbol(name) for name in given]
    return float(compile_expressions(symbols, sympy_expression(parse(text)))(*given.values()))


READ = {
    "1/3 + 0.25": 1 / 3 + 0.25,
    "2 - 3 - 4": -5.0,
    "24/2/3*4": 16.0,
    "-3**2": -9.0,
    "2**3**2": 512.0,
    "2^3": 8.0,
    "-(-3)": 3.0,
    "+.5e1": 5.0,
    "pi": math.pi,
    "π/2": math.pi / 2,
    "e**2": math.e**2,
    "abs(-3)": 3.0,
    "Abs(-3)": 3.0,
    "sign(-3) + sign(0)": -1.0,
    "heaviside(2) + heaviside(-2)": 1.0,
    "max(1, 3, 2)": 3.0,
    "min(1, 3, 2)": 1.0,
    "Max(min(3, 4), 2)": 3.0,
    "ln(e)": 1.0,
    "sqrt(16)": 4.0,
    "sinh(1)**2 - cosh(1)**2": -1.0,
    "tan(0.3)*cos(0.3)/sin(0.3)": 1.0,
    "asin(0.3) + acos(0.3)": math.pi / 2,
    "atan(1) + log(exp(2)) + tanh(0)": math.pi / 4 + 2,
    " ( 1\n+\t1 ) ": 2.0,
}


@pytest.mark.parametrize("text", READ)
def test_values_of_formulas_are_correct(text: str) -> None:
    assert value(text) == pytest.approx(READ[text], rel=1e-14)


def test_names_in_a_formula_are_read_in_order_and_with_their_primes() -> None:
    tree = parse("λ*z'' + rest_1*(z' - max(z, lambda)) + z")
    assert [one.text for one in formulas.variable_names(tree)] == ["λ", "z''", "rest_1", "z'", "z", "lambda"]
    assert formulas.constant_names(parse("pi*k + e"), parse("e")) == ("pi", "e")
    assert parse("-k") == Operation("-", (Name("k"),))
    assert parse("k*0.10") == Operation("*", (Name("k"), Number("0.10")))


def test_unicode_variants_of_a_greek_letter_are_the_same_name() -> None:
    """The micro sign is read as mu; two forms of phi are equal."""
    assert parse("\u00b5*\u03d5") == parse("\u03bc*\u03c6")


def test_python_keywords_are_valid_names_in_a_formula() -> None:
    """They do not appear in the source of the compiled function."""
    names = ("lambda", "def", "numpy", "exit", "open", "a0000", "x0", "None", "class", "math")
    assert value(" + ".join(names), **dict.fromkeys(names, 1.5)) == 15.0


HOSTILE = {
    "attribute": "z.subs(z, y)",
    "dunder call": "__import__('os').system('true')",
    "lambda": "(lambda: 1)()",
    "list": "[z, 1]",
    "generator": "sum(z for z in y)",
    "dictionary": "{1: z}",
    "string": "z + 'rm'",
    "f-string": "f'{z}'",
    "subscript": "z[0]",
    "walrus": "(z := 1)",
    "assignment": "z = 1",
    "keyword": "exp(x=1)",
    "star": "exp(*z)",
    "tuple": "(z, 1)",
    "condition": "1 if z else 2",
    "comparison": "z < 1",
    "and": "z and 1",
    "bit operation": "z | 1",
    "matrix product": "z @ z",
    "division with floor": "z // 2",
    "statement": "import os",
    "comment": "z # + 1",
    "await": "await z",
    "call of a name": "system(1)",
    "call of a number": "2(3)",
    "decorated": "@z",
    "imaginary": "1j*z",
    "underscore in a number": "1_000",
    "huge power": "9**9**9",
    "power of a sum": "(a + b + c + z)**200",
    "power of a power": "((a + z)**40)**40",
    "product of sums": "*".join(f"(a{k} + b)" for k in range(24)),
    "product of roots": "(sqrt(2) + sqrt(3) + sqrt(5) + sqrt(7))**60",
    "signs": "-" * 5000 + "z",
    "brackets": "(" * 5000 + "z" + ")" * 5000,
    "calls": "exp(" * 60 + "z" + ")" * 60,
    "tower": "z**" * 200 + "z",
    "divisions": "z/" * 200 + "z",
    "characters": "1" * 10**6,
    "digits": "1" * 100,
    "many names": "+".join(["z"] * 1000),
    "infinite": "1e999",
    "infinite value": "exp(1e4)",
    "tiny": "1e-300*z",
    "hidden zero": "z/(2 - 2)",
    "zero after all": "1/(z - z)",
    "root": "sqrt(-1)",
    "logarithm": "log(0)",
    "cube root": "(-8)**(1/3)",
    "cyrillic": "\u0435xp(z)",
    "full width": "\uff45\uff58\uff50(z)",
    "mathematical letter": "\U0001d467 + 1",
    "minus sign": "z − 1",
    "invisible": "z\u200b + 1",
    "right to left": "z \u202e+ 1",
    "null": "z\x00",
    "escape": "z \x1b[2J",
    "prime before": "'z",
    "prime of a function": "sin' + 1",
    "function alone": "exp + 1",
    "too few": "exp()",
    "too many": "exp(1, 2)",
    "nothing": "",
    "two signs": "a * / b",
    "open": "(a + b",
    "empty": "()",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_invalid_formulas_are_refused_in_one_line(name: str) -> None:
    with pytest.raises(FormulaError) as caught:
        sympy_expression(parse(HOSTILE[name]))
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 400
    assert "; " in message or ": " in message  # problem and remedy


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2*z + 3x", "an operator is missing at 'x'; write *"),
        ("k(z - r)", "'k' is not a function at 'k(z - r)'; write k*(...)"),
        ("a + b.c", "'.' is not a character of formulas at '.c'"),
        ("z − 1", "MINUS SIGN) is not a character of formulas at '− 1'; write -"),
        ("z²", "write **2"),
        ("z[1]", "write ("),
        ("9**9**9", "a power of 3.87e+08 at '9**9**9'; the highest power is 64"),
        ("(a + b + c + z)**40", "1.23e+04 terms"),
        ("k*exp", "'exp' is a function at 'exp'; write exp(...)"),
        ("1e200*z", "a number of magnitude 1e+200 at '1e200*z'; it must be from 1e-100 to 1e+100"),
    ],
)
def test_error_in_a_formula_gives_the_problem_its_position_and_a_remedy(text: str, words: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse(text)
    assert words in str(caught.value)


def test_functions_can_be_added_to_the_grammar_of_formulas() -> None:
    more = {**formulas.FUNCTIONS, "cube": formulas.FormulaFunction(lambda x: x**3)}
    assert parse("cube(z)", more) == Operation("cube", (Name("z"),))
    with pytest.raises(FormulaError, match="'cube' is not a function"):
        parse("cube(z)")


@pytest.mark.parametrize("text", ["(a + b + c + z)**9", "max(k, " * 10 + "z" + ")" * 10])
def test_formula_of_maximum_size_is_expanded_quickly(text: str) -> None:
    """Every formula within the limits of size can be expanded and compiled."""
    import sympy

    found = sympy.expand(sympy_expression(parse(text)))
    z = sympy.Symbol("z")
    arguments = sorted(found.free_symbols, key=str)
    function = compile_expressions(arguments, [found, found.diff(z)])
    assert np.isfinite(function(*np.full(len(arguments), 0.5))).all()


def test_every_function_allowed_in_formulas_compiles() -> None:
    import sympy

    x, y = sympy.symbols("x y")
    for name, function in formulas.FUNCTIONS.items():
        text = f"{name}(0.3*x)" if function.max_operands == 1 else f"{name}(x, 0.2, y)"
        compiled = compile_expressions([x, y], [sympy_expression(parse(text))])
        operands = (0.15,) if function.max_operands == 1 else (0.5, 0.2, 0.1)
        found = compiled(np.array([0.5, 0.5]), np.array([0.1, 0.1]))[0]
        np.testing.assert_allclose(found, function.value(*operands), rtol=1e-12)


def test_derivative_of_a_maximum_is_the_slope_of_its_larger_operand() -> None:
    import sympy

    x, y = sympy.symbols("x y", real=True)
    slope = sympy_expression(parse("max(x, y)*min(x, 2)"), {"x": x, "y": y}).diff(x)
    compiled = compile_expressions([x, y], slope)
    assert compiled(1.0, 3.0) == 3.0
    assert compiled(4.0, 3.0) == 2.0
    assert compiled(2.5, 3.0) == 0.0
