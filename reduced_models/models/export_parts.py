"""Parts that all exports of a model as code share: safe names, expressions, and plain comments."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from granular.formulas import MAX_CHARACTERS
from granular.shared.messages import visible
from reduced_models.models.fitted_law import FittedLaw

if TYPE_CHECKING:
    import sympy

STEPS = 512
"""Steps of a period, times the law's resolution: Runge-Kutta's phase is then exact to 1e-9."""


class ExportParts(NamedTuple):
    """A model's law with names that code in any language can have.

    Attributes
    ----------
    parameters, hidden, inputs : tuple of str
        ``p_``, ``h_`` and ``u_`` in front, so that none is a word of a language.
    acceleration : Expr
        Of z, z_first and these.
    rates : tuple of Expr
        Of the hidden states.
    values : tuple of float
        Of the parameters.
    initial : tuple of float
        Height, velocity and hidden states at the record's start.
    step : float
        Longest step of a solver [s].
    comments : tuple of str
        ASCII, each on one line, without signs that could end a comment.
    """

    parameters: tuple[str, ...]
    hidden: tuple[str, ...]
    inputs: tuple[str, ...]
    acceleration: sympy.Expr
    rates: tuple[sympy.Expr, ...]
    values: tuple[float, ...]
    initial: tuple[float, ...]
    step: float
    comments: tuple[str, ...]


def export_parts(model: FittedLaw) -> ExportParts:
    """Those of a model."""
    import sympy

    law, parsed = model.law, model.law.parsed
    groups = [
        (law.parameters, safe_names("p_", law.parameters)),
        (law.hidden, safe_names("h_", law.hidden)),
        (law.inputs, safe_names("u_", law.inputs)),
    ]
    symbols = {
        sympy.Symbol(name): sympy.Symbol(safe)
        for names, found in groups
        for name, safe in zip(names, found, strict=True)
    }

    def plain(expression: sympy.Expr) -> sympy.Expr:
        found = expression.xreplace(symbols)
        return found.replace(sympy.Heaviside, lambda at, *_: (1 + sympy.sign(at)) / 2)

    (_, parameters), (_, hidden), (_, inputs) = groups
    period = 1.0 if model.at_rest is None else model.at_rest.period
    low, high = model.domain.get("height", (float("nan"), float("nan")))
    unit = model.unit
    words = [
        f"The law {law.name}, fitted: {law.equation}",
        f"Source of the law: {law.source or 'own'}. "
        f"Data: {model.provenance.get('data', 'unknown')}.",
        f"Fitted to {model.coordinate}s from {low:.6g} to {high:.6g} {unit}.",
        f"State: {model.coordinate} [{unit}], velocity [{unit}/s]"
        + "".join(f", {name}" for name in hidden),
        "Parameters: " + ", ".join(
            f"{safe} [{model.unit_of(name) or '?'}]"
            for name, safe in zip(law.parameters, parameters, strict=True)
        ),
    ]  # fmt: skip
    return ExportParts(
        parameters=parameters,
        hidden=hidden,
        inputs=inputs,
        acceleration=plain(parsed.acceleration),
        rates=tuple(plain(rate) for rate in parsed.hidden.values()),
        values=tuple(float(model.parameters[name]) for name in law.parameters),
        initial=(*map(float, model.initial), *(model.hidden.get(name, 0.0) for name in law.hidden)),
        step=period / (STEPS * law.resolution),
        comments=tuple(map(comment, words)),
    )


def safe_names(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    """Names of ASCII letters, digits and underscores behind a prefix, no two of them alike."""
    found: list[str] = []
    for name in names:
        ascii_name = "".join(map(_spelt, name))
        while prefix + ascii_name in found:
            ascii_name += "_"
        found.append(prefix + ascii_name)
    return tuple(found)


def _spelt(sign: str) -> str:
    """A letter as it is, or a Greek one by its name."""
    if sign.isascii() and (sign.isalnum() or sign == "_"):
        return sign
    return unicodedata.name(sign, "x").split()[-1].lower()


def comment(words: str) -> str:
    """A text that can stand in a comment of any language, whatever it holds."""
    plain = visible(words, MAX_CHARACTERS).encode("ascii", "replace").decode()
    # A backslash would go on with a comment on the next line, and so would "??/" in C.
    return plain.replace("\\", "/").replace("??", "? ?").replace("*/", "* /").replace("/*", "/ *")
