"""A model as a function for MATLAB and Octave."""

from __future__ import annotations

from reduced_models.models.export_parts import export_parts
from reduced_models.models.fitted_law import FittedLaw

_TEMPLATE = """\
function [heights, velocities] = {name}(times, start, inputs)
{comments}
% {name}(times)                 motion from the record's start, at increasing times [s]
% {name}(times, start)          from another state
% {name}(times, start, inputs)  with a row of inputs a time, each held up to the next
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
% by Runge-Kutta of fourth order
  first = rates(state, inputs);
  second = rates(state + step / 2 * first, inputs);
  third = rates(state + step / 2 * second, inputs);
  fourth = rates(state + step * third, inputs);
  state = state + step / 6 * (first + 2 * second + 2 * third + fourth);
end

function found = rates(state, inputs)
  shift = {shift}; scale = {scale};  % height = shift + scale z
  z = (state(1) - shift) / scale; z_first = state(2) / scale;
{locals}  found = [state(2); scale * ({acceleration}){hidden}];
end
"""


def matlab_source(model: FittedLaw, name: str = "damper_model") -> str:
    """Source of a function of that name, which its file must have too."""
    from sympy.printing.octave import OctaveCodePrinter

    parts = export_parts(model)
    printer = OctaveCodePrinter({"user_functions": {"max": "max", "min": "min"}})
    lines = [f"{name} = {value!r};" for name, value in zip(parts.parameters, parts.values,
                                                            strict=True)]  # fmt: skip
    lines += [f"{name} = state({3 + k});" for k, name in enumerate(parts.hidden)]
    lines += [f"{name} = inputs({1 + k});" for k, name in enumerate(parts.inputs)]
    return _TEMPLATE.format(
        name=name,
        comments="\n".join(f"% {words}" for words in parts.comments),
        initial="; ".join(map(repr, parts.initial)),
        inputs=len(parts.inputs),
        step=repr(parts.step),
        shift=repr(float(model.map.shift)),
        scale=repr(float(model.map.scale)),
        locals="".join(f"  {line}\n" for line in lines),
        acceleration=printer.doprint(parts.acceleration),
        hidden="".join(f"; {printer.doprint(rate)}" for rate in parts.rates),
    )
