"""A fitted law as an element between two bodies: height and velocity in, the force of the bed out.

A law tells the acceleration of a piston of the mass M on a cell at rest, so the bed pushes it with

    force = mass scale z'' + load,

where z'' is what the law says of the height and the velocity of the piston over the cell, mass is
what the law's accelerations belong to, and load is the weight that the bed carries at rest. The
hidden states of the law are the element's own; the masses stay with the bodies on both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from granular.shared.errors import InputError
from reduced_models.laws.equation import rate_derivatives
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.source_code import (
    C_ADVANCE,
    C_MATHS,
    MATLAB_NAME,
    LawForExport,
    array_element_names,
    c_array_initialiser,
    c_assignments,
    c_expression,
    c_local_variables,
    docstring_lines,
    escape_comment,
    matlab_expression,
    modelica_expression,
    modelica_parts,
    prepare_law_for_export,
    python_expression,
    replace_steps_by_signs,
)

if TYPE_CHECKING:
    import sympy

DERIVED = "derived"
"""Name of the laws that `derive` finds."""
GRAVITY = 9.8
"""[m/s^2], that of the packaged scenes, where nothing else is given."""
_PYTHON_NAME = "    {name} = {array}[{index}]\n"
_PYTHON = '''\
"""The bed as an element: its force on a piston, by height and velocity over the cell.

{comments}
"""

import numpy

PARAMETERS = {parameters}
START = {start}  # hidden states


def _values(height, velocity, states, inputs, parameters):
    """Force [N] and rates of the hidden states."""
{locals}    return {force}, numpy.array([{rates}], dtype=float)


def force(height, velocity, states=START, inputs=(), parameters=PARAMETERS):
    """Force of the bed on the piston [N], upwards; the cell is pushed down as much."""
    return _values(height, velocity, states, inputs, parameters)[0]


def rates(height, velocity, states=START, inputs=(), parameters=PARAMETERS):
    """Time derivatives of the hidden states."""
    return _values(height, velocity, states, inputs, parameters)[1]
'''
_HEADER = """\
#ifndef {guard}_H
#define {guard}_H
{comments}
/* States: {states}. Inputs: {inputs}. Parameters: {names}. */

enum {{ {guard}_STATES = {n_states}, {guard}_INPUTS = {n_inputs},
       {guard}_PARAMETERS = {n_parameters} }};

extern const double {name}_parameters[];    /* as fitted */
extern const double {name}_start[];         /* hidden states at the start */
extern const double {name}_longest_step;    /* of {name}_advance [s] */

/* Force of the bed on the piston [N], upwards; the cell is pushed down as much. */
double {name}_force(const double *parameters, const double *states, const double *inputs);

/* Time derivatives of the hidden states. */
void {name}_rates(const double *parameters, const double *states, const double *inputs,
                double *rates);

/* Hidden states after some time [s] with the inputs held. */
void {name}_advance(const double *parameters, double *states, const double *inputs, double time);
#endif
"""
_BODY = """
{maths}
const double {name}_parameters[] = {{ {parameters} }};
const double {name}_start[] = {{ {start} }};
const double {name}_longest_step = {step};

double {name}_force(const double *parameters, const double *states, const double *inputs)
{{
{locals}    return {force};
}}

void {name}_rates(const double *parameters, const double *states, const double *inputs,
                double *rates)
{{
{locals}    (void)rates;
{rates}}}
{advance}"""
_MATLAB = """\
function [force, rates] = {name}(height, velocity, states, inputs, parameters)
{comments}
% force = {name}(height, velocity)  of the bed on the piston [N], upwards; the hidden states at rest
% [force, rates] = {name}(height, velocity, states, inputs, parameters)  and the states' rates
% states: {states}; start at [{start}]. parameters: {names}
  if nargin < 3 || isempty(states), states = [{start}]; end
  if nargin < 4, inputs = []; end
  if nargin < 5, parameters = [{parameters}]; end
{locals}  force = {force};
  rates = [{rates}];
end
"""
_MODELICA = """\
model {name} "The bed of a damper between the cell (flange_a) and the piston (flange_b)"
  extends Modelica.Mechanics.Translational.Interfaces.PartialCompliantWithRelativeStates;
{comments}
{parameters}
{inputs}{hidden}  output Real force(unit = "N") "of the bed on the piston, along s_rel";
equation
  force = {force};
  f = -force;
{rates}end {name};
"""


class ForcePort(NamedTuple):
    """A fitted law as an element with a force."""

    model: FittedLaw
    mass: float  # [kg]; none along a prescribed stroke, of which the law is one of the force
    load: float  # [N]


class PortForExport(NamedTuple):
    """A port with names that code in any language can have."""

    law: LawForExport
    inputs: tuple[str, ...]
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    start: tuple[float, ...]
    units: tuple[str, ...]
    outputs: tuple[sympy.Expr, ...]
    comments: tuple[str, ...]


def force_port(model: FittedLaw, mass: float | None, gravity: float = GRAVITY) -> ForcePort:
    """Return a law of a record as an element; mass [kg], gravity [m/s^2]."""
    if model.coordinate_unit == "rad":
        raise InputError("the law is one of an angle; a force between two bodies needs a height")
    if model.law.name == DERIVED:
        raise InputError(
            "the bed's mass moves along in a derived law, so its force depends on the acceleration; export "
            "the whole model, or fit a law to a run"
        )
    if model.law.prescribed:
        if len(model.law.observations) > 1:
            raise InputError("the law observes several columns; an element has one force")
        return ForcePort(model, 0.0, 0.0)
    if mass is None or not mass > 0.0:
        raise InputError(
            "the law of a record tells accelerations, not forces; give the mass of the piston that "
            "was recorded, --mass '7.5 kg'"
        )
    return ForcePort(model, mass, mass * gravity)


def prepare_port_for_export(port: ForcePort) -> PortForExport:
    """Prepare an element for export: names that code can have, values, and expressions."""
    import sympy

    model, law = port.model, prepare_law_for_export(port.model)
    numbers = [
        (name, value, model.unit_of_parameter(own))
        for name, value, own in zip(law.parameters, law.values, model.law.parameters, strict=True)
    ]
    mass, load = sympy.symbols("mass load")
    motion = {sympy.Symbol("z"): sympy.Symbol("height"), sympy.Symbol("z_first"): sympy.Symbol("velocity")}
    if model.law.prescribed:
        force, meaning = law.acceleration, "force is that which moves the coordinate upwards."
    else:
        force = mass * law.acceleration + load
        meaning = (
            "force = mass z'' + load, of the bed on the piston: the masses of piston and cell are those of "
            "the bodies on both sides."
        )
        numbers += [("mass", port.mass, "kg"), ("load", port.load, "N")]
    words = (*law.comments[:3], escape_comment(meaning))
    return PortForExport(
        law,
        ("height", "velocity", *law.inputs),
        law.hidden,
        tuple(name for name, *_ in numbers),
        tuple(float(value) for _, value, _ in numbers),
        law.initial[2:],
        tuple(unit for *_, unit in numbers),
        tuple(output.xreplace(motion) for output in (force, *law.rates)),
        words,
    )


def port_jacobian(parts: PortForExport) -> list[list[sympy.Expr]] | None:
    """Return the derivatives of the states' rates, then of the force, by the states, then by the inputs."""
    import sympy

    real = {
        symbol: sympy.Symbol(symbol.name, real=True)
        for output in parts.outputs
        for symbol in output.free_symbols
    }
    force, *rates = (output.xreplace(real) for output in parts.outputs)
    by = [sympy.Symbol(name) for name in (*parts.states, *parts.inputs)]
    slopes = rate_derivatives([*rates, force], [real.get(symbol, symbol) for symbol in by])
    plain = {symbol: own for own, symbol in real.items()}
    flat = [
        replace_steps_by_signs(slope.replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)).xreplace(plain)
        for slope in slopes
    ]
    if any(slope.has(sympy.Derivative, sympy.Subs) for slope in flat):
        return None
    return [flat[k : k + len(by)] for k in range(0, len(flat), len(by))]


def port_c_sources(port: ForcePort, name: str) -> tuple[str, str]:
    """Header and source in C99 of a bed, all declared names with the given name in front."""
    parts = prepare_port_for_export(port)
    force, *rates = parts.outputs
    words = {
        "name": name,
        "guard": name.upper(),
        "step": repr(parts.law.step),
        "comments": "\n".join(f"/* {line} */" for line in parts.comments),
        "states": ", ".join(parts.states) or "none",
        "inputs": ", ".join(["height [m]", "velocity [m/s]", *parts.law.inputs]),
        "names": ", ".join(_names_with_units(parts)),
        "n_states": len(parts.states),
        "n_inputs": len(parts.inputs),
        "n_parameters": len(parts.parameters),
        "parameters": c_array_initialiser(parts.values),
        "start": c_array_initialiser(parts.start),
        "locals": c_local_variables(parts),
        "force": c_expression(force),
        "rates": c_assignments("rates", rates),
        "maths": C_MATHS,
        "advance": C_ADVANCE.format(linkage="", name=name, guard=name.upper()),
    }
    return _HEADER.format(**words), _BODY.format(**words)


def _names_with_units(parts: PortForExport) -> list[str]:
    return [
        f"{name} [{escape_comment(unit) or '?'}]"
        for name, unit in zip(parts.parameters, parts.units, strict=True)
    ]


def port_matlab_source(port: ForcePort, name: str) -> str:
    """MATLAB and Octave source of a function of that name, as a block of Simulink takes it."""
    parts = prepare_port_for_export(port)
    force, *rates = map(matlab_expression, parts.outputs)
    lines = array_element_names(parts.law, ("inputs",), MATLAB_NAME, 1)
    lines += array_element_names(parts, ("parameters", "states"), MATLAB_NAME, 1)
    return _MATLAB.format(
        name=name,
        comments="\n".join(f"% {line}" for line in parts.comments),
        states=", ".join(parts.states) or "none",
        start="; ".join(map(repr, parts.start)),
        names=", ".join(_names_with_units(parts)),
        parameters="; ".join(map(repr, parts.values)),
        locals=lines,
        force=force,
        rates="; ".join(rates),
    )


def port_python_source(port: ForcePort) -> str:
    """Python source of a module with the force and the rates, which needs NumPy alone."""
    parts = prepare_port_for_export(port)
    force, *rates = map(python_expression, parts.outputs)
    lines = array_element_names(parts.law, ("inputs",), _PYTHON_NAME)
    lines += "".join(f'    {name} = parameters["{name}"]\n' for name in parts.parameters)
    lines += array_element_names(parts, ("states",), _PYTHON_NAME)
    return _PYTHON.format(
        comments=docstring_lines(parts.comments),
        parameters=repr(dict(zip(parts.parameters, parts.values, strict=True))),
        start=repr(parts.start),
        locals=lines,
        force=force,
        rates=", ".join(rates),
    )


def port_modelica_source(port: ForcePort, name: str) -> str:
    """Modelica text of a model of that name, between the flanges of cell and piston."""
    import sympy

    parts = prepare_port_for_export(port)
    flange = {sympy.Symbol("height"): sympy.Symbol("s_rel"), sympy.Symbol("velocity"): sympy.Symbol("v_rel")}
    force, *rates = (output.xreplace(flange) for output in parts.outputs)
    return _MODELICA.format(
        name=name,
        force=modelica_expression(force),
        **modelica_parts(
            parts.comments,
            zip(parts.parameters, parts.values, parts.units, strict=True),
            parts.law.inputs,
            zip(parts.states, parts.start, rates, strict=True),
        ),
    )
