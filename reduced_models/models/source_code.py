"""A model as source code of other languages: C99, MATLAB and Octave, Modelica.

All are made of the same parts: safe names, expressions, and plain comments.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from granular.formulas import MAX_CHARACTERS
from granular.shared.message_text import sanitize
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.records.inputs import STROKE

if TYPE_CHECKING:
    import sympy

STEPS = 512
"""Steps of a period, times the law's resolution: Runge-Kutta's phase is then exact to 1e-9."""


class LawForExport(NamedTuple):
    """A model's law with names that code in any language can have."""

    parameters: tuple[str, ...]
    hidden: tuple[str, ...]
    inputs: tuple[str, ...]
    acceleration: sympy.Expr  # the force along a prescribed stroke
    rates: tuple[sympy.Expr, ...]
    values: tuple[float, ...]
    initial: tuple[float, ...]
    step: float  # [s]
    comments: tuple[str, ...]  # ASCII, a line each, nothing that could end a comment


def prepare_law_for_export(model: FittedLaw) -> LawForExport:
    """Prepare a model's law for export: names that code can have, values, and expressions."""
    import sympy

    law, parsed = model.law, model.law.parsed_equation
    columns = [name for name in law.inputs if name not in STROKE]
    columns += ["acceleration"] * (STROKE[2] in law.inputs)
    groups = [
        (law.parameters, ascii_names("p_", law.parameters)),
        (law.hidden, ascii_names("h_", law.hidden)),
        (columns, ascii_names("u_", columns)),
    ]
    symbols = {
        sympy.Symbol(name): sympy.Symbol(safe)
        for names, result in groups
        for name, safe in zip(names, result, strict=True)
    }

    def plain(expression: sympy.Expr) -> sympy.Expr:
        return replace_steps_by_signs(expression.xreplace(symbols))

    if law.prescribed:
        symbols[sympy.Symbol("z_second")] = sympy.Symbol("u_acceleration")
    (_, parameters), (_, hidden), (_, inputs) = groups
    period = 1.0 if model.at_rest is None else model.at_rest.period
    period = min([period, *(2.0 * math.pi / cycle.frequency for cycle in model.cycles)])
    low, high = model.domain.get("height", (float("nan"), float("nan")))
    unit = model.unit
    words = [
        f"The law {law.name}, fitted: {law.equation}",
        f"Source of the law: {law.source or 'own'}. Data: {model.provenance.get('data', 'unknown')}.",
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
        hidden=hidden,
        inputs=inputs,
        acceleration=plain(parsed.observations[model.observation] if law.prescribed else parsed.acceleration),
        rates=tuple(plain(rate) for rate in parsed.hidden.values()),
        values=tuple(map(float, model.all_parameters.values())),
        initial=(*map(float, model.initial), *(model.hidden.get(name, 0.0) for name in law.hidden)),
        step=period / (STEPS * law.step_ratio),
        comments=tuple(map(escape_comment, words)),
    )


def replace_steps_by_signs(expression: sympy.Expr) -> sympy.Expr:
    """Expression with signs in place of steps, which languages do not have."""
    import sympy

    return expression.replace(sympy.Heaviside, lambda at, *_: (1 + sympy.sign(at)) / 2)


def ascii_names(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    """Names of ASCII letters, digits and underscores behind a prefix, no two of them alike."""
    result: list[str] = []
    for name in names:
        ascii_name = "".join(map(_ascii_name, name))
        while prefix + ascii_name in result:
            ascii_name += "_"
        result.append(prefix + ascii_name)
    return tuple(result)


def _ascii_name(character: str) -> str:
    """Letter as it is, or a Greek one by its name."""
    if character.isascii() and (character.isalnum() or character == "_"):
        return character
    return unicodedata.name(character, "x").split()[-1].lower()


def escape_comment(words: str) -> str:
    """Text that can stand in a comment of any language, whatever it holds."""
    plain = sanitize(words, MAX_CHARACTERS).encode("ascii", "replace").decode()
    # A backslash would go on with a comment on the next line, and so would "??/" in C.
    return plain.replace("\\", "/").replace("??", "? ?").replace("*/", "* /").replace("/*", "/ *")


_C = """\
{comments}

#include <math.h>
#include <stddef.h>

#ifndef M_PI
#define M_PI 3.14159265358979323846
#endif
#ifndef M_E
#define M_E 2.71828182845904523536
#endif

enum {{ MODEL_STATES = {states}, MODEL_INPUTS = {inputs}, MODEL_PARAMETERS = {count} }};

static const double model_parameters[] = {{ {parameters} }};
static const double model_initial[] = {{ {initial} }};
static const double model_longest_step = {step};  /* [s] */

/* Time derivatives of a state; inputs may be NULL where the law has none. */
static void model_rates(const double *parameters, const double *state, const double *inputs,
                        double *rates)
{{
    const double z = state[0], z_first = state[1];
{locals}    (void)z; (void)z_first; (void)parameters; (void)inputs;
    rates[0] = state[1];
    rates[1] = {acceleration};
{hidden}}}

/* A state after a step [s], by Runge-Kutta of fourth order; the inputs are held. */
static void model_step(const double *parameters, double *state, const double *inputs, double step)
{{
    double first[MODEL_STATES], second[MODEL_STATES], third[MODEL_STATES], fourth[MODEL_STATES];
    double middle[MODEL_STATES];
    model_rates(parameters, state, inputs, first);
    for (int k = 0; k < MODEL_STATES; k++) middle[k] = state[k] + 0.5 * step * first[k];
    model_rates(parameters, middle, inputs, second);
    for (int k = 0; k < MODEL_STATES; k++) middle[k] = state[k] + 0.5 * step * second[k];
    model_rates(parameters, middle, inputs, third);
    for (int k = 0; k < MODEL_STATES; k++) middle[k] = state[k] + step * third[k];
    model_rates(parameters, middle, inputs, fourth);
    for (int k = 0; k < MODEL_STATES; k++)
        state[k] += step / 6.0 * (first[k] + 2.0 * second[k] + 2.0 * third[k] + fourth[k]);
}}

/* A state after some time [s], in steps that are short enough. */
static void model_advance(const double *parameters, double *state, const double *inputs,
                          double time)
{{
    const int steps = time > 0.0 ? (int)ceil(time / model_longest_step) : 0;
    for (int k = 0; k < steps; k++) model_step(parameters, state, inputs, time / steps);
}}

/* Heights at increasing times, from a state; inputs holds MODEL_INPUTS numbers a time. */
void model_simulate(const double *times, int count, const double *start, const double *inputs,
                    double *heights)
{{
    double state[MODEL_STATES];
    for (int k = 0; k < MODEL_STATES; k++) state[k] = start ? start[k] : model_initial[k];
    for (int k = 0; k < count; k++) {{
        const double *held = inputs && k ? inputs + (size_t)(k - 1) * MODEL_INPUTS : inputs;
        if (k) model_advance(model_parameters, state, held, times[k] - times[k - 1]);
        heights[k] = state[0];
    }}
}}
"""


def c_source(model: FittedLaw) -> str:
    """C99 source of a model: rates, a step, and `model_simulate`."""
    parts = prepare_law_for_export(model)
    rates = [f"    rates[{2 + k}] = {c_expression(rate)};\n" for k, rate in enumerate(parts.rates)]
    return _C.format(
        comments="\n".join(f"/* {words} */" for words in parts.comments),
        states=2 + len(parts.hidden),
        inputs=len(parts.inputs),
        count=len(parts.parameters),
        parameters=c_array_initialiser(parts.values),
        initial=c_array_initialiser(parts.initial),
        step=repr(parts.step),
        locals="".join(_local_variable_lines(parts)),
        acceleration=c_expression(parts.acceleration),
        hidden="".join(rates),
    )


def c_expression(expression: sympy.Expr) -> str:
    """Expression in C99."""
    from sympy.printing.c import C99CodePrinter

    printer = C99CodePrinter({"user_functions": {"max": "fmax", "min": "fmin"}})
    return str(printer.doprint(expression))


def c_array_initialiser(numbers: Sequence[float]) -> str:
    """Elements of an array in C, separated by commas; "0.0" where there is none."""
    return ", ".join(map(repr, numbers)) or "0.0"


def _local_variable_lines(parts: LawForExport) -> list[str]:
    """Parameters, hidden states and inputs by their names."""
    groups = ((parts.parameters, "parameters", 0), (parts.hidden, "state", 2), (parts.inputs, "inputs", 0))
    return [
        f"    const double {name} = {array}[{first + k}];\n"
        for names, array, first in groups
        for k, name in enumerate(names)
    ]


_MATLAB = """\
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
  z = state(1); z_first = state(2);
{locals}  found = [state(2); {acceleration}{hidden}];
end
"""


def matlab_source(model: FittedLaw, name: str = "damper_model") -> str:
    """MATLAB and Octave source of a function of that name, which its file must have too."""
    parts = prepare_law_for_export(model)
    lines = [f"{name} = {value!r};" for name, value in zip(parts.parameters, parts.values, strict=True)]
    lines += [f"{name} = state({3 + k});" for k, name in enumerate(parts.hidden)]
    lines += [f"{name} = inputs({1 + k});" for k, name in enumerate(parts.inputs)]
    return _MATLAB.format(
        name=name,
        comments="\n".join(f"% {words}" for words in parts.comments),
        initial="; ".join(map(repr, parts.initial)),
        inputs=len(parts.inputs),
        step=repr(parts.step),
        locals="".join(f"  {line}\n" for line in lines),
        acceleration=matlab_expression(parts.acceleration),
        hidden="".join(f"; {matlab_expression(rate)}" for rate in parts.rates),
    )


def matlab_expression(expression: sympy.Expr) -> str:
    """Expression in MATLAB and Octave."""
    from sympy.printing.octave import OctaveCodePrinter

    printer = OctaveCodePrinter({"user_functions": {"max": "max", "min": "min"}})
    return str(printer.doprint(expression))


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
    """Modelica text of a model of that name, for OpenModelica, Dymola and others."""
    parts = prepare_law_for_export(model)
    names = zip(model.law.parameters, parts.parameters, parts.values, strict=True)
    return _MODELICA.format(
        name=name,
        title=escape_comment(model.law.name).replace('"', "'"),
        comments="\n".join(f"  // {words}" for words in parts.comments),
        parameters="\n".join(
            f'  parameter Real {safe}(unit = "{modelica_unit(model.unit_of_parameter(own))}") = {value!r};'
            for own, safe, value in names
        ),
        unit=model.unit,
        inputs="".join(f"  input Real {name};\n" for name in parts.inputs),
        height=repr(parts.initial[0]),
        velocity=repr(parts.initial[1]),
        hidden="".join(
            f"  Real {name}(start = {value!r}, fixed = true);\n"
            for name, value in zip(parts.hidden, parts.initial[2:], strict=True)
        ),
        acceleration=modelica_expression(parts.acceleration),
        rates="".join(
            f"  der({name}) = {modelica_expression(rate)};\n"
            for name, rate in zip(parts.hidden, parts.rates, strict=True)
        ),
    )


def modelica_expression(expression: sympy.Expr) -> str:
    """Expression in Modelica: powers by ^, and pi and e as numbers."""
    import sympy

    result = expression.xreplace({sympy.pi: sympy.pi.evalf(17), sympy.E: sympy.E.evalf(17)})
    return str(sympy.sstr(result)).replace("**", "^").replace("Abs(", "abs(")


def modelica_unit(unit: str) -> str:
    """Return the unit as Modelica writes it; empty where it is a user's own word."""
    plain = unit.replace("^", "").replace("(m s2)", "(m.s2)").replace("(m2 s2)", "(m2.s2)")
    return plain if plain in _UNITS else ""


_UNITS = {
    "1",
    "kg",
    "N",
    "m",
    "rad",
    "s",
    "1/s",
    "rad/s",
    "1/s2",
    "m/s2",
    "rad/s2",
    "1/m",
    "1/rad",
    "1/(m.s2)",
    "1/(m2.s2)",
}
