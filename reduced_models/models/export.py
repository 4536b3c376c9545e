"""A model as text or code, in the language that a file's ending names.

Here are its equations, LaTeX, and a Python function that needs NumPy alone; C, MATLAB, Modelica and
FMUs have files of their own.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from granular.shared.errors import InputError
from granular.shared.files import write_text
from granular.shared.message_text import quote, sanitize
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.fmu import VERSIONS, write_fmu
from reduced_models.models.ports import (
    ForcePort,
    force_port,
    port_c_sources,
    port_matlab_source,
    port_modelica_source,
    port_python_source,
)
from reduced_models.models.source_code import (
    c_source,
    docstring_lines,
    matlab_source,
    modelica_source,
    prepare_law_for_export,
    python_expression,
)

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
    """Heights at increasing times, by Runge-Kutta of fourth order, steps between two of them."""
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
    """Python source of a stand-alone module: rates and a solver, or the force along a prescribed stroke."""
    if model.law.prescribed:
        return port_python_source(force_port(model, None))
    parts, names = prepare_law_for_export(model), model.law.parameters

    def at(position: str) -> str:
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
        at_0=at("now"),
        at_half=at("now + 0.5 * step"),
        at_1=at("now + step"),
    )


def equations_text(model: FittedLaw) -> str:
    """Equation, parameters with units and intervals, domain and provenance; then LaTeX."""
    lines = [str(model)]
    for name, (low, high) in model.domain.items():
        unit = {"height": model.coordinate_unit, "velocity": f"{model.coordinate_unit}/s"}.get(name, "")
        lines.append(f"  seen: {name} from {low:.5g} to {high:.5g} {unit}".rstrip())
    lines += [f"  {name}: {words}" for name, words in model.provenance.items()]
    lines += ["", "LaTeX:", model.latex, model.fitted_latex]
    for name, rate in model.law.parsed_equation.hidden.items():
        lines.append(f"hidden state: {name}' = {rate}".replace("z_first", "z'"))
    return "\n".join(lines) + "\n"


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

Source = Callable[[FittedLaw, str], str]
PortSource = Callable[[ForcePort, str], str]
SOURCES: dict[str, tuple[str, Source, PortSource]] = {
    ".py": (
        "a Python module that needs NumPy alone",
        lambda model, _: numpy_source(model),
        lambda port, _: port_python_source(port),
    ),
    ".c": (
        "C99",
        lambda model, _: c_source(model),
        lambda port, name: f'#include "{name}.h"\n{port_c_sources(port, name)[1]}',
    ),
    ".m": ("a function for MATLAB and Octave", matlab_source, port_matlab_source),
    ".mo": ("a Modelica model", modelica_source, port_modelica_source),
}
"""Language of each ending, and its writers, of a model and of a port, and the file's name."""


def write_code(model: FittedLaw | ForcePort, path: Path, fmi: int = 2) -> str:
    """Write a model, or its force as an element, as code, and tell in words what was written."""
    if fmi not in VERSIONS:
        raise InputError(f"fmi = {fmi}; give {' or '.join(map(str, VERSIONS))}")
    if path.suffix == ".fmu":
        write_fmu(model, path, fmi)
        return f"an FMU (FMI {fmi}.0, co-simulation and model exchange)"
    if path.suffix not in SOURCES:
        known = ", ".join([*SOURCES, ".fmu"])
        raise InputError(f"{sanitize(path)} ends in {quote(path.suffix)}; give one of {known}")
    named = path.suffix in (".m", ".mo") or (isinstance(model, ForcePort) and path.suffix == ".c")
    if named and (_NAME.fullmatch(path.stem) is None or path.stem in _WORDS):
        raise InputError(
            f"{quote(path.name)} cannot be a function's name; give letters, digits and underscores"
        )
    what, source, port_source = SOURCES[path.suffix]
    if not isinstance(model, ForcePort):
        write_text(path, source(model, path.stem))
    else:
        write_text(path, port_source(model, path.stem))
        if path.suffix == ".c":
            write_text(path.with_suffix(".h"), port_c_sources(model, path.stem)[0])
            what += " with its header"
    return what
