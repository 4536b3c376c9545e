"""Export of a model as a function for MATLAB and Octave."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from granular.shared.files import write_text
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.ports import ForcePort, parameter_names_with_units, prepare_port_for_export
from reduced_models.models.source_code import (
    name_array_elements,
    prepare_law_for_export,
    require_function_name,
)

if TYPE_CHECKING:
    import sympy


MATLAB_NAME = "  {name} = {array}({index});\n"


_MATLAB = """\
function [heights, velocities] = {name}(times, start, inputs)
{comments}
% {name}(times)                 motion from the record's start, at increasing times [s]
% {name}(times, start)          from another state
% {name}(times, start, inputs)  with a row of inputs per time, each held up to the next
  if nargin < 2 || isempty(start), start = [{initial}]; end
  if nargin < 3, inputs = zeros(numel(times), {inputs}); end
  longest = {step};  % s
  state = start(:);
  heights = zeros(size(times)); velocities = heights;
  for k = 1:numel(times)
    if k > 1
      held = inputs(k - 1, :); span = times(k) - times(k - 1);
      count = ceil(span / longest);
      for place = 1:count
        state = advanced(state, held, span / count);
      end
    end
    heights(k) = state(1); velocities(k) = state(2);
  end
end

function state = advanced(state, inputs, step)
% by the fourth-order Runge-Kutta method
  first = rates(state, inputs);
  second = rates(state + step / 2 * first, inputs);
  third = rates(state + step / 2 * second, inputs);
  fourth = rates(state + step * third, inputs);
  state = state + step / 6 * (first + 2 * second + 2 * third + fourth);
end

function found = rates(states, inputs)
{locals}  found = [{rates}];
end
"""


def matlab_source(model: FittedLaw, name: str = "damper_model") -> str:
    """Return the source of a MATLAB and Octave function; its file must have the same name."""
    parts = prepare_law_for_export(model)
    lines = [f"  {name} = {value!r};\n" for name, value in zip(parts.parameters, parts.values, strict=True)]
    lines.append(name_array_elements(parts, ("states", "inputs"), MATLAB_NAME, 1))
    return _MATLAB.format(
        name=name,
        comments="\n".join(f"% {words}" for words in parts.comments),
        initial="; ".join(map(repr, parts.initial)),
        inputs=len(parts.inputs),
        step=repr(parts.step),
        locals="".join(lines),
        rates="; ".join(map(matlab_expression, parts.state_rates)),
    )


def matlab_expression(expression: sympy.Expr) -> str:
    """Return an expression in MATLAB and Octave."""
    from sympy.printing.octave import OctaveCodePrinter

    printer = OctaveCodePrinter({"user_functions": {"max": "max", "min": "min"}})
    return str(printer.doprint(expression))


_PORT = """\
function [force, rates] = {name}(height, velocity, states, inputs, parameters)
{comments}
% force = {name}(height, velocity)  {direction};
%   hidden states at their start
% [force, rates] = {name}(height, velocity, states, inputs, parameters)  and the states' rates
% states: {states}; start at [{start}]. parameters: {names}
  if nargin < 3 || isempty(states), states = [{start}]; end
  if nargin < 4, inputs = []; end
  if nargin < 5, parameters = [{parameters}]; end
{locals}  force = {force};
  rates = [{rates}];
end
"""


def port_matlab_source(port: ForcePort, name: str) -> str:
    """Return the source of a MATLAB and Octave function, which a Simulink function block can contain."""
    parts = prepare_port_for_export(port)
    force, *rates = map(matlab_expression, parts.outputs)
    lines = name_array_elements(parts.law, ("inputs",), MATLAB_NAME, 1)
    lines += name_array_elements(parts, ("parameters", "states"), MATLAB_NAME, 1)
    return _PORT.format(
        name=name,
        comments="\n".join(f"% {line}" for line in parts.comments),
        direction=parts.direction,
        states=", ".join(parts.states) or "none",
        start="; ".join(map(repr, parts.start)),
        names=", ".join(parameter_names_with_units(parts)),
        parameters="; ".join(map(repr, parts.values)),
        locals=lines,
        force=force,
        rates="; ".join(rates),
    )


def write_matlab(model: FittedLaw | ForcePort, path: Path, _: int) -> str:
    """Write a model as a MATLAB function with the file's name."""
    require_function_name(path)
    if isinstance(model, ForcePort):
        write_text(path, port_matlab_source(model, path.stem))
    else:
        write_text(path, matlab_source(model, path.stem))
    return "a function for MATLAB and Octave"
