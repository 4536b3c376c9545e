"""The last step of every method: a structure is fitted through its differential equation."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import BudgetError, GranularError
from reduced_models.discovery.open_terms import OpenTerms
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.terms import (
    complexity,
    law_words,
    sort_terms,
    split_terms,
    state_symbols,
    term_text,
)
from reduced_models.fitting.fit import fit
from reduced_models.fitting.force_fit import fit_force
from reduced_models.laws.force_law import ForceLaw
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.sensor import Sensor

if TYPE_CHECKING:
    import sympy

STARTS = 4
_SPREAD = 0.1  # of the start values about the coefficients of the structure
_MOST_NUMBERS = 12
_STEEPNESS = 100.0  # of tanh for sign(z'), in typical speeds
_RESOLUTION = 4  # of laws with it, in the steps of smooth ones
_MEMORY_RESOLUTION = 2  # of laws with a hidden state
_LONGEST_NAME = 80  # characters
_AS_IT_IS = Sensor("force", gain=1.0)


def polish_candidate(
    candidate: CandidateEquation,
    records: Sequence[PistonRecord],
    height_map: HeightMap,
    column: str | None = None,
    seed: int = 0,
    open_terms: OpenTerms | None = None,
) -> CandidateEquation:
    """Candidate with its numbers fitted by `fit`, or with a note that says why there are none.

    Parameters
    ----------
    candidate : CandidateEquation
        Of z''. The scales of its hidden state are numbers as well.
    records : sequence of PistonRecord
        That fraction all numbers but their initial states.
    height_map : HeightMap
    column : str, optional
        Of the records, that is the input.
    seed : int
    open_terms : OpenTerms, optional
        Terms that hold numbers of their own.
    """
    opened = None if open_terms is None else open_terms.opened(candidate)
    template, values = opened or parametrise(candidate.expression)
    if len(values) > _MOST_NUMBERS:
        return dataclasses.replace(
            candidate, note=f"has {len(values)} numbers, more than the {_MOST_NUMBERS} of a fit"
        )
    memory = candidate.memory
    if memory is not None:
        values |= dict(zip(memory.state.scales, memory.scales, strict=True))
    law = law_from_template(smooth_sign(template, records, height_map), values, column, law_name(candidate))
    if memory is not None:
        law = dataclasses.replace(
            law,
            equation=memory.state.within(law.equation),
            positive=memory.state.scales,
            resolution=max(_MEMORY_RESOLUTION, law.resolution),
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # notes stand in the model
            models = fit(records, law, map=height_map, starts=STARTS, test_fraction=0.0, seed=seed)
    except BudgetError:
        raise
    except GranularError as error:
        return dataclasses.replace(candidate, note=str(error))
    import sympy

    numbers = models[0].parameters
    if opened and open_terms is not None:
        expression = open_terms.closed(candidate, numbers)
    else:
        expression = template.xreplace({sympy.Symbol(name): sympy.Float(numbers[name]) for name in values})
    nodes = complexity(expression)
    if memory is not None:
        nodes += len(memory.scales)
        memory = memory._replace(scales=tuple(numbers[name] for name in memory.state.scales))
    return dataclasses.replace(
        candidate, expression=expression, complexity=nodes, models=models, memory=memory
    )


def fit_force_candidate(
    candidate: CandidateEquation,
    records: Sequence[PistonRecord],
    height_map: HeightMap,
    column: str | None = None,
    seed: int = 0,
) -> CandidateEquation:
    """Candidate for a force with its numbers fitted by `fit_force`; arguments as of `polish_candidate`."""
    import sympy

    template, values = parametrise(candidate.expression)
    z, v, u = state_symbols()
    shift, scale = height_map.shift, height_map.scale
    plain = (
        template if height_map == HeightMap() else template.xreplace({z: (z - shift) / scale, v: v / scale})
    )
    memory = candidate.memory
    inputs = () if column is None or memory is not None or not plain.has(u) else (column,)
    plain = plain.xreplace({u: sympy.Symbol(column)} if inputs else {})
    equation, scales = f"force = {term_text(plain)}", dict[str, float]()
    if memory is not None:
        scales = dict(zip(memory.state.scales, memory.scales, strict=True))
        equation = memory.state.within(equation)
    law = ForceLaw(law_name(candidate), equation, positive=tuple(scales), inputs=inputs)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # notes stand in the model
            model = fit_force(
                records, law, sensor=_AS_IT_IS, starts=STARTS, test_fraction=0.0, start=scales, seed=seed
            )
    except GranularError as error:
        return dataclasses.replace(candidate, note=str(error))
    numbers = model.parameters
    if memory is not None:
        memory = memory._replace(scales=tuple(numbers[name] for name in scales))
    expression = template.xreplace({sympy.Symbol(name): sympy.Float(numbers[name]) for name in values})
    models: Any = (model,)
    return dataclasses.replace(candidate, expression=expression, models=models, memory=memory)


def law_name(candidate: CandidateEquation) -> str:
    """Name of a law by its terms; how it was found does not matter to who reads of it."""
    terms = candidate.terms
    if (
        candidate.left == "force"
        and sum(value for term, value in (terms or {}).items() if not term.still) > 0
    ):
        # A force that moves has the sign of the speed, and not that of a resistance.
        terms = {term: -value for term, value in (terms or {}).items()}
    if candidate.memory is not None:
        terms = {term: value for term, value in (terms or {}).items() if not term.driven}
        words = [word for word in (law_words(terms), candidate.memory.state.name) if word]
        return " + ".join(words)
    name = law_words(terms) if terms else ""
    if not name or len(name) > _LONGEST_NAME:
        return f"discovered formula of {len(parametrise(candidate.expression)[1])} numbers"
    return name


def parametrise(expression: sympy.Expr) -> tuple[sympy.Expr, dict[str, float]]:
    """Expression with symbols c0, c1 ... for its numbers, and their values.

    The coefficients of a sum of library terms come in the order of the terms, so that the same
    structure is the same law; elsewhere every floating-point number is one.
    """
    import sympy

    terms = split_terms(expression)
    if terms is not None:
        names = {f"c{k}": terms[term] for k, term in enumerate(sort_terms(terms))}
        parts = (
            sympy.Symbol(name) * term.expression for name, term in zip(names, sort_terms(terms), strict=True)
        )
        return sympy.Add(*parts), names
    floats = sorted(expression.atoms(sympy.Float), key=float)
    symbol_of = {item: sympy.Symbol(f"c{k}") for k, item in enumerate(floats)}
    return expression.xreplace(symbol_of), {symbol_of[item].name: float(item) for item in floats}


def smooth_sign(template: sympy.Expr, records: Sequence[PistonRecord], height_map: HeightMap) -> sympy.Expr:
    """Expression with a steep tanh(z') for sign(z'), which no solver can step across."""
    import sympy

    _, v, _ = state_symbols()
    fastest = max(float(np.gradient(record.height, record.time).std()) for record in records)
    speed = fastest / abs(height_map.scale)
    # A power of ten, so that records of one kind share compiled code.
    steepness = 10.0 ** round(math.log10(_STEEPNESS / speed))
    return template.subs(sympy.sign(v), sympy.tanh(sympy.Float(steepness, 4) * v))


def law_from_template(template: sympy.Expr, values: dict[str, float], column: str | None, name: str) -> Law:
    """Law z'' = template, whose fit starts near the given values."""
    import sympy

    def start(_: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        return {name: value * (1.0 + _SPREAD * random.normal(size=count)) for name, value in values.items()}

    if column is not None:
        template = template.xreplace({state_symbols()[2]: sympy.Symbol(column)})
    inputs = (column,) if column is not None and template.has(sympy.Symbol(column)) else ()
    return Law(
        name=name,
        equation=f"z'' = {term_text(template)}",
        start=start,
        mapped=True,
        source="discovered in the record",
        inputs=inputs,
        resolution=_RESOLUTION if template.has(sympy.tanh) else 1,
    )
