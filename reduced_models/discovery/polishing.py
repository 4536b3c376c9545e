"""The last step of every method: a structure is fitted through its differential equation."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, TimeBudgetError
from reduced_models.discovery.parametric_terms import ParametricTerms
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.terms import (
    AnyTerm,
    CustomTerm,
    Term,
    complexity,
    expression_text,
    replace_numbers_by_symbols,
    sort_terms,
    state_symbols,
)
from reduced_models.fitting.fit import fit
from reduced_models.fitting.parameter import Parameter
from reduced_models.fitting.problem import FitOptions
from reduced_models.fitting.start_values import start_values_near
from reduced_models.laws.law import HeightLine, Law
from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    import sympy

STARTS = 4
_MOST_NUMBERS = 12
_STEEPNESS = 100.0  # of tanh for sign(z'), in typical speeds
# Of laws with it, in the steps of smooth ones: as `reduced_models.laws.coulomb` takes for its tanh.
_RESOLUTION = 4
_MEMORY_RESOLUTION = 2  # of laws with a hidden state
_LONGEST_NAME = 80  # characters
_AS_IT_IS = Sensor("force", gain=1.0)
_NONE_OPEN = ParametricTerms()


def polish_candidate(
    candidate: CandidateEquation,
    records: Sequence[PistonRecord],
    line: HeightLine,
    column: str | None = None,
    seed: int = 0,
    open_terms: ParametricTerms = _NONE_OPEN,
) -> CandidateEquation:
    """Fit a candidate's numbers to the records themselves by `fit`; line [m]."""
    template, values = open_terms.with_symbols(candidate)
    if len(values) > _MOST_NUMBERS:
        return dataclasses.replace(
            candidate, note=f"has {len(values)} numbers, more than the {_MOST_NUMBERS} of a fit"
        )
    hidden_state = candidate.hidden_state
    if hidden_state is not None:
        values |= dict(zip(hidden_state.kind.scales, hidden_state.scales, strict=True))
    moving = candidate.left_side == "z''"
    measured = _AS_IT_IS if candidate.left_side == "force" else None
    given = {name: Parameter(value, fixed=True) for name, value in line._asdict().items()}
    if not moving:
        given = {name: Parameter(value) for name, value in values.items()}
    elif line == HeightLine():
        given = {}
    try:
        law = law_of_candidate(candidate, template, values, records, line, column)
        with warnings.catch_warnings(action="ignore"):  # notes stand in the model
            models = fit(
                records,
                law,
                parameters=given,
                starts=STARTS,
                test_fraction=0.0,
                seed=seed,
                options=FitOptions(measured=measured),
            )
    except TimeBudgetError:
        raise
    except GranularError as error:
        return dataclasses.replace(candidate, note=str(error))
    numbers = models[0].parameters
    expression = open_terms.with_numbers(candidate, template, numbers)
    nodes = complexity(expression)
    if hidden_state is not None:
        nodes += len(hidden_state.scales)
        hidden_state = hidden_state._replace(scales=tuple(numbers[name] for name in hidden_state.kind.scales))
    return dataclasses.replace(
        candidate, expression=expression, complexity=nodes, models=models, hidden_state=hidden_state
    )


def law_of_candidate(
    candidate: CandidateEquation,
    template: sympy.Expr,
    values: dict[str, float],
    records: Sequence[PistonRecord],
    line: HeightLine,
    column: str | None = None,
) -> Law:
    """Law of a candidate with symbols for its numbers, whose fit starts near their values; line [m]."""
    import sympy

    z, v, u = state_symbols()
    moving, hidden_state = candidate.left_side == "z''", candidate.hidden_state
    if moving:
        template = replace_sign_by_tanh(template, records, line)
    elif line != HeightLine():
        template = template.xreplace({z: line.coordinate(z), v: v / line.scale})
    if column is not None:
        template = template.xreplace({u: sympy.Symbol(column)})
    inputs = (column,) if column is not None and template.has(sympy.Symbol(column)) else ()
    equation, positive = f"{candidate.left_side} = {expression_text(template)}", tuple[str, ...]()
    resolution = _RESOLUTION if moving and template.has(sympy.tanh) else 1
    if hidden_state is not None:
        equation = hidden_state.kind.substitute_into(equation)
        positive = hidden_state.kind.scales
        resolution = max(_MEMORY_RESOLUTION, resolution)
    if moving and line != HeightLine():
        # As parameters, so that records of one kind share compiled code.
        equation += "; height = shift + scale*z"
        values = values | line._asdict()
    return Law(
        name=name_candidate_law(candidate),
        equation=equation,
        start=start_values_near(values),
        positive=positive,
        source="discovered in the record",
        inputs=inputs,
        resolution=resolution,
    )


def name_candidate_law(candidate: CandidateEquation) -> str:
    """Name of a candidate's law by its terms, such as "viscous + softening"."""
    terms = candidate.terms
    if (
        candidate.left_side == "force"
        and sum(value for term, value in (terms or {}).items() if not term.is_speed_independent) > 0
    ):
        # A force that moves has the sign of the speed, and not that of a resistance.
        terms = {term: -value for term, value in (terms or {}).items()}
    if candidate.hidden_state is not None:
        terms = {term: value for term, value in (terms or {}).items() if not term.has_input}
        words = [word for word in (describe_law(terms), candidate.hidden_state.kind.name) if word]
        return " + ".join(words)
    name = describe_law(terms) if terms else ""
    if not name or len(name) > _LONGEST_NAME:
        return f"discovered formula of {len(replace_numbers_by_symbols(candidate.expression)[1])} numbers"
    return name


_BY_SPEED = {1: "viscous", 2: "quadratic drag", 3: "cubic drag"}


def describe_law(terms: Mapping[AnyTerm, float]) -> str:
    """Describe a law in an engineer's words, by the terms of z'' and their coefficients."""
    others = [term for term in sort_terms(terms) if not _is_spring_term(term)]
    others.sort(key=lambda term: isinstance(term, CustomTerm) or abs(term.speed - 1))
    words = [_damping_term_words(term, terms[term]) for term in others]
    springs = {
        term.power: value for term, value in terms.items() if isinstance(term, Term) and _is_spring_term(term)
    }
    return " + ".join(dict.fromkeys([*words, *_spring_words(springs)]))


def _is_spring_term(term: AnyTerm) -> bool:
    return isinstance(term, Term) and term.is_speed_independent and not term.has_input


def _damping_term_words(term: AnyTerm, coefficient: float) -> str:
    if isinstance(term, CustomTerm) or term.has_input or not term.odd or term.speed > max(_BY_SPEED):
        return term.text
    word = _BY_SPEED.get(term.speed, "dry friction")
    if term.power:
        return f"{word} by {Term(term.power).text}"
    return word if coefficient < 0.0 else f"negative {word}"


def _spring_words(springs: Mapping[int, float]) -> list[str]:
    """Word for a spring by its coefficients of powers of z; none where there is no spring."""
    linear, curved = springs.get(1, 0.0), {power: value for power, value in springs.items() if power > 1}
    if not curved:
        return ["linear spring"] if linear else []
    if any(power % 2 == 0 for power in curved):
        return ["asymmetric spring"]
    stiffer = curved[max(curved)] < 0.0
    if linear > 0.0:
        return ["two wells" if stiffer else "unstable spring"]
    return ["hardening" if stiffer else "softening"]


def replace_sign_by_tanh(
    template: sympy.Expr, records: Sequence[PistonRecord], line: HeightLine
) -> sympy.Expr:
    """Expression with a steep tanh(z') for sign(z'), which no solver can step across; line [m]."""
    import sympy

    _, v, _ = state_symbols()
    fastest = max(float(np.gradient(record.height, record.time).std()) for record in records)
    speed = fastest / abs(line.scale)
    # A power of ten, so that records of one kind share compiled code.
    steepness = 10.0 ** round(math.log10(_STEEPNESS / speed))
    return template.subs(sympy.sign(v), sympy.tanh(sympy.Float(steepness, 4) * v))
