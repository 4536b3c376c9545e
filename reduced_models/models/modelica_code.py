"""Export of a model to Modelica."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from granular.shared.files import write_text
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.ports import DRIVING, ForcePort, prepare_port_for_export
from reduced_models.models.source_code import escape_comment, prepare_law_for_export, require_function_name

if TYPE_CHECKING:
    import sympy


_MODELICA = """\
model {name} "{title}"
{comments}
{parameters}
{inputs}  Real height(start = {height}, fixed = true, unit = "{unit}");
  Real velocity(start = {velocity}, fixed = true, unit = "{unit}/s");
{hidden}protected
  Real z = height;
  Real z_first = velocity;
equation
  der(height) = velocity;
  der(velocity) = {acceleration};
{rates}end {name};
"""


def modelica_source(model: FittedLaw, name: str = "DamperModel") -> str:
    """Return the text of a Modelica model, for OpenModelica, Dymola and others."""
    parts = prepare_law_for_export(model)
    units = map(model.unit_of_parameter, model.law.parameters)
    return _MODELICA.format(
        name=name,
        title=escape_comment(model.law.name).replace('"', "'"),
        unit=model.coordinate_unit,
        height=repr(parts.initial[0]),
        velocity=repr(parts.initial[1]),
        acceleration=modelica_expression(parts.acceleration),
        **modelica_parts(
            parts.comments,
            zip(parts.parameters, parts.values, units, strict=True),
            parts.inputs,
            zip(parts.hidden, parts.initial[2:], parts.rates, strict=True),
        ),
    )


def modelica_parts(
    comments: Iterable[str],
    parameters: Iterable[tuple[str, float, str]],
    inputs: Iterable[str],
    states: Iterable[tuple[str, float, sympy.Expr]],
) -> dict[str, str]:
    """Return the lines of a Modelica model for parameters, inputs, states with start values, and rates."""
    hidden, rates = [], []
    for name, start, rate in states:
        hidden.append(f"  Real {name}(start = {start!r}, fixed = true);\n")
        rates.append(f"  der({name}) = {modelica_expression(rate)};\n")
    return {
        "comments": "\n".join(f"  // {line}" for line in comments),
        "parameters": "\n".join(
            f'  parameter Real {name}(unit = "{modelica_unit(unit)}") = {value!r};'
            for name, value, unit in parameters
        ),
        "inputs": "".join(f"  input Real {name};\n" for name in inputs),
        "hidden": "".join(hidden),
        "rates": "".join(rates),
    }


def modelica_expression(expression: sympy.Expr) -> str:
    """Return an expression in Modelica: powers with ^, and pi and e as numbers."""
    import sympy

    result = expression.xreplace({sympy.pi: sympy.pi.evalf(17), sympy.E: sympy.E.evalf(17)})
    return str(sympy.sstr(result)).replace("**", "^").replace("Abs(", "abs(")


def modelica_unit(unit: str) -> str:
    """Return the unit in Modelica's notation; empty for a custom unit."""
    plain = unit.replace("^", "").replace("(m s2)", "(m.s2)").replace("(m2 s2)", "(m2.s2)")
    return plain if _UNIT.fullmatch(plain) else ""


_UNIT = re.compile(r"(1|kg|N|m|rad|s)(/(s2?|m|rad|\(m2?\.s2\)))?")


_PORT = """\
model {name} "The bed of a damper between the cell (flange_a) and the piston (flange_b)"
  extends Modelica.Mechanics.Translational.Interfaces.PartialCompliantWithRelativeStates;
{comments}
{parameters}
{inputs}{hidden}  output Real force(unit = "N") "{direction}";
equation
  force = {force};
  f = {sign}force;
{rates}end {name};
"""


def port_modelica_source(port: ForcePort, name: str) -> str:
    """Return the text of a Modelica model that acts between the flanges of cell and piston."""
    import sympy

    parts = prepare_port_for_export(port)
    flange = {sympy.Symbol("height"): sympy.Symbol("s_rel"), sympy.Symbol("velocity"): sympy.Symbol("v_rel")}
    force, *rates = (output.xreplace(flange) for output in parts.outputs)
    return _PORT.format(
        name=name,
        direction=parts.direction,
        sign="" if parts.direction == DRIVING else "-",
        force=modelica_expression(force),
        **modelica_parts(
            parts.comments,
            zip(parts.parameters, parts.values, parts.units, strict=True),
            parts.law.inputs,
            zip(parts.states, parts.start, rates, strict=True),
        ),
    )


def write_modelica(model: FittedLaw | ForcePort, path: Path, _: int) -> str:
    """Write a model as a Modelica model with the file's name."""
    require_function_name(path)
    if isinstance(model, ForcePort):
        write_text(path, port_modelica_source(model, path.stem))
    else:
        write_text(path, modelica_source(model, path.stem))
    return "a Modelica model"
