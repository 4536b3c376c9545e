"""Parts of exported source code for all languages: safe names, expressions, and plain comments."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.formulas import MAX_CHARACTERS
from granular.shared.errors import InputError, quote, sanitize
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.records.inputs import STROKE

if TYPE_CHECKING:
    import sympy

STEPS = 512
"""Runge-Kutta steps per period for a phase error below 1e-9, to be multiplied by `Law.step_ratio`."""


class LawForExport(NamedTuple):
    """A model's law with names that are valid in all languages."""

    parameters: tuple[str, ...]
    states: tuple[str, ...]  # z, z_first, hidden ones
    inputs: tuple[str, ...]
    acceleration: sympy.Expr  # the force along a prescribed stroke
    rates: tuple[sympy.Expr, ...]  # rates of the hidden states
    values: tuple[float, ...]
    initial: tuple[float, ...]
    step: float  # [s]
    comments: tuple[str, ...]  # ASCII lines that cannot end a comment

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden states."""
        return self.states[2:]

    @property
    def state_rates(self) -> tuple[sympy.Expr, ...]:
        """Rates of all states."""
        import sympy

        return (sympy.Symbol("z_first"), self.acceleration, *self.rates)


def prepare_law_for_export(model: FittedLaw) -> LawForExport:
    """Prepare a model's law for export, with valid names, values and expressions."""
    import sympy

    law, parsed = model.law, model.law.parsed_equation
    columns = [name for name in law.inputs if name not in STROKE]
    columns += ["acceleration"] * (STROKE[2] in law.inputs)
    parameters, hidden = ascii_names("p_", law.parameters), ascii_names("h_", law.hidden)
    inputs = ascii_names("u_", columns)
    pairs = zip((*law.parameters, *law.hidden, *columns), (*parameters, *hidden, *inputs), strict=True)
    symbols = {sympy.Symbol(name): sympy.Symbol(safe) for name, safe in pairs}

    def expression_with_safe_names(expression: sympy.Expr) -> sympy.Expr:
        return replace_steps_by_signs(expression.xreplace(symbols))

    if law.prescribed:
        symbols[sympy.Symbol("z_second")] = sympy.Symbol("u_acceleration")
    period = 1.0 if model.at_rest is None else model.at_rest.period
    period = min([period, *(2.0 * math.pi / cycle.frequency for cycle in model.cycles)])
    low, high = model.domain.get("height", (float("nan"), float("nan")))
    unit = model.coordinate_unit
    words = [
        f"The law {law.name}, fitted: {law.equation}",
        f"Source of the law: {law.source or 'user-defined'}. "
        f"Data: {model.provenance.get('data', 'unknown')}.",
        f"Fitted to {model.coordinate}s from {low:.6g} to {high:.6g} {unit}.",
        f"State: {model.coordinate} [{unit}], velocity [{unit}/s]" + "".join(f", {name}" for name in hidden),
        "Parameters: "
        + ", ".join(
            f"{safe} [{model.unit_of_parameter(name) or '?'}]"
            for name, safe in zip(law.parameters, parameters, strict=True)
        ),
    ]
    return LawForExport(
        parameters=parameters,
        states=("z", "z_first", *hidden),
        inputs=inputs,
        acceleration=expression_with_safe_names(
            parsed.observations[model.observation] if law.prescribed else parsed.acceleration
        ),
        rates=tuple(expression_with_safe_names(rate) for rate in parsed.hidden.values()),
        values=tuple(map(float, model.all_parameters.values())),
        initial=(*map(float, model.initial), *(model.hidden.get(name, 0.0) for name in law.hidden)),
        step=period / (STEPS * law.step_ratio),
        comments=tuple(map(escape_comment, words)),
    )


def replace_steps_by_signs(expression: sympy.Expr) -> sympy.Expr:
    """Return an expression with sign functions in place of Heaviside steps, which the languages lack."""
    import sympy

    return expression.replace(sympy.Heaviside, lambda at, *_: (1 + sympy.sign(at)) / 2)


def ascii_names(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return distinct names with a prefix, spelled with ASCII letters, digits and underscores."""
    result: list[str] = []
    for name in names:
        ascii_name = "".join(map(_ascii_name, name))
        while prefix + ascii_name in result:
            ascii_name += "_"
        result.append(prefix + ascii_name)
    return tuple(result)


def _ascii_name(character: str) -> str:
    """Return an ASCII character unchanged, and a Greek letter by its name."""
    if character.isascii() and (character.isalnum() or character == "_"):
        return character
    return unicodedata.name(character, "x").split()[-1].lower()


def escape_comment(words: str) -> str:
    """Return a text that cannot end or extend a comment in any of the languages."""
    plain = sanitize(words, MAX_CHARACTERS).encode("ascii", "replace").decode()
    # A backslash, or "??/" in C, would continue the comment on the next line.
    return plain.replace("\\", "/").replace("??", "? ?").replace("*/", "* /").replace("/*", "/ *")


def docstring_lines(comments: Iterable[str]) -> str:
    """Return comments as lines of a Python docstring, escaped so that they cannot end the docstring."""
    return "\n".join(line.replace('"', "'") for line in comments)


def python_expression(expression: sympy.Expr) -> str:
    """Return an expression in Python with functions of NumPy."""
    from sympy.printing.numpy import NumPyPrinter

    return str(NumPyPrinter({"fully_qualified_modules": True}).doprint(expression))


def name_array_elements(element: Any, arrays: Sequence[str], line: str, first: int = 0) -> str:
    """Return lines of code that name each element of the given arrays; indices start at ``first``."""
    return "".join(
        line.format(name=name, array=array, index=first + k)
        for array in arrays
        for k, name in enumerate(getattr(element, array))
    )


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")


_WORDS = {
    "break",
    "case",
    "catch",
    "continue",
    "do",
    "else",
    "elseif",
    "end",
    "equation",
    "for",
    "function",
    "global",
    "if",
    "model",
    "otherwise",
    "parfor",
    "persistent",
    "return",
    "spmd",
    "switch",
    "try",
    "until",
    "while",
}


def require_function_name(path: Path) -> None:
    """Raise an error if a file's name cannot be the name of a function or model."""
    if _NAME.fullmatch(path.stem) is None or path.stem in _WORDS:
        raise InputError(
            f"{quote(path.name)} cannot be a function's name; give letters, digits and underscores"
        )
