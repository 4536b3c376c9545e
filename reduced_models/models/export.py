"""Export of a model as text or code; the file's ending selects the language.

This module writes equations, LaTeX, and a Python function that needs only NumPy. Separate modules,
listed in the table of writers below, write C, MATLAB, Modelica and FMUs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from granular.shared.errors import InputError, quote, sanitize
from granular.shared.files import write_text
from granular.shared.registry import Registry
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.ports import ForcePort, force_port, prepare_port_for_export
from reduced_models.models.source_code import (
    docstring_lines,
    name_array_elements,
    prepare_law_for_export,
    python_expression,
)

VERSIONS = (2, 3)
"""Supported versions of FMI."""
_TEMPLATE = '''"""{comments}
"""

import numpy

PARAMETERS = {parameters}
INITIAL = {initial}


def rates(state, {inputs}parameters=PARAMETERS):
    """Time derivatives of the state."""
    {states} = state
    {names} = (parameters[name] for name in {name_list})
    return numpy.array([{rates}])


def simulate(times, state=INITIAL, {inputs_default}steps=8):
    """Heights at increasing times, by fourth-order Runge-Kutta with ``steps`` steps between times."""
    state, heights = numpy.array(state, dtype=float), [state[0]]
    for start, stop in zip(times[:-1], times[1:]):
        step = (stop - start) / steps
        for place in range(steps):
            now = start + place * step
            slope_1 = rates(state{at_0})
            slope_2 = rates(state + 0.5 * step * slope_1{at_half})
            slope_3 = rates(state + 0.5 * step * slope_2{at_half})
            slope_4 = rates(state + step * slope_3{at_1})
            state = state + step / 6 * (slope_1 + 2 * slope_2 + 2 * slope_3 + slope_4)
        heights.append(state[0])
    return numpy.array(heights)
'''


def numpy_source(model: FittedLaw) -> str:
    """Return Python source: rates and a solver, or for a law along a stroke its force."""
    if model.law.prescribed:
        return port_python_source(force_port(model, None))
    parts, names = prepare_law_for_export(model), model.law.parameters

    def inputs_at(position: str) -> str:
        return "".join(f", {name}({position})" for name in parts.inputs)

    return _TEMPLATE.format(
        comments=docstring_lines(parts.comments),
        parameters=repr(dict(zip(names, parts.values, strict=True))),
        initial=repr(parts.initial),
        inputs="".join(f"{name}, " for name in parts.inputs),
        inputs_default="".join(f"{name}=lambda t: 0.0, " for name in parts.inputs),
        states=", ".join(parts.states),
        names="".join(f"{name}, " for name in parts.parameters).rstrip(),
        name_list=repr(names),
        rates=", ".join(map(python_expression, parts.state_rates)),
        at_0=inputs_at("now"),
        at_half=inputs_at("now + 0.5 * step"),
        at_1=inputs_at("now + step"),
    )


def equations_text(model: FittedLaw) -> str:
    """Return the equation, parameters with units and intervals, domain, provenance and LaTeX as text."""
    lines = [str(model)]
    for name, (low, high) in model.domain.items():
        unit = {"height": model.coordinate_unit, "velocity": f"{model.coordinate_unit}/s"}.get(name, "")
        lines.append(f"  fitted range: {name} from {low:.5g} to {high:.5g} {unit}".rstrip())
    lines += [f"  {name}: {words}" for name, words in model.provenance.items()]
    lines += ["", "LaTeX:", model.latex, model.fitted_latex]
    for name, rate in model.law.parsed_equation.hidden.items():
        lines.append(f"hidden state: {name}' = {rate}".replace("z_first", "z'"))
    return "\n".join(lines) + "\n"


_ELEMENT_NAME = "    {name} = {array}[{index}]\n"


_PORT = '''\
"""Force of the bed on a piston, from the piston's height and velocity relative to the cell.

{comments}
"""

import numpy

PARAMETERS = {parameters}
START = {start}  # hidden states


def _values(height, velocity, states, inputs, parameters):
    """Force [N] and rates of the hidden states."""
{locals}    return {force}, numpy.array([{rates}], dtype=float)


def force(height, velocity, states=START, inputs=(), parameters=PARAMETERS):
    """Force {direction}."""
    return _values(height, velocity, states, inputs, parameters)[0]


def rates(height, velocity, states=START, inputs=(), parameters=PARAMETERS):
    """Time derivatives of the hidden states."""
    return _values(height, velocity, states, inputs, parameters)[1]
'''


def port_python_source(port: ForcePort) -> str:
    """Return the source of a Python module, based on NumPy alone, with the force and the rates."""
    parts = prepare_port_for_export(port)
    force, *rates = map(python_expression, parts.outputs)
    lines = name_array_elements(parts.law, ("inputs",), _ELEMENT_NAME)
    lines += "".join(f'    {name} = parameters["{name}"]\n' for name in parts.parameters)
    lines += name_array_elements(parts, ("states",), _ELEMENT_NAME)
    return _PORT.format(
        comments=docstring_lines(parts.comments),
        direction=parts.direction,
        parameters=repr(dict(zip(parts.parameters, parts.values, strict=True))),
        start=repr(parts.start),
        locals=lines,
        force=force,
        rates=", ".join(rates),
    )


def write_python(model: FittedLaw | ForcePort, path: Path, _: int) -> str:
    """Write a model as a Python module that needs only NumPy."""
    write_text(path, port_python_source(model) if isinstance(model, ForcePort) else numpy_source(model))
    return "a Python module that needs only NumPy"


Writer = Callable[[FittedLaw | ForcePort, Path, int], str]
"""Function of a model or `ForcePort`, a path and an FMI version; writes the file and describes it."""

MODEL_EXPORTERS = Registry[Writer](
    "ending",
    "reduced_models.exporters",
    {
        ".py": write_python,
        ".c": "reduced_models.models.c_code:write_c",
        ".m": "reduced_models.models.matlab_code:write_matlab",
        ".mo": "reduced_models.models.modelica_code:write_modelica",
        ".fmu": "reduced_models.models.fmu:write_fmu",
    },
    lambda _, write: callable(write),
    "a function",
)
"""Writers of models by file ending."""


def write_code(model: FittedLaw | ForcePort, path: Path, fmi: int = 2) -> str:
    """Write a model, or the force of a `ForcePort`, as code; return a description of the file."""
    if fmi not in VERSIONS:
        raise InputError(f"fmi = {fmi}; give {' or '.join(map(str, VERSIONS))}")
    if path.suffix not in MODEL_EXPORTERS:
        known = ", ".join(MODEL_EXPORTERS)
        raise InputError(f"{sanitize(path)} ends in {quote(path.suffix)}; give one of {known}")
    return MODEL_EXPORTERS[path.suffix](model, path, fmi)
