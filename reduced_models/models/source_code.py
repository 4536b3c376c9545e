"""A model as source code of other languages: C99, MATLAB and Octave, Modelica.

All are made of the same parts: safe names, expressions, and plain comments.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

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
    states: tuple[str, ...]  # z, z_first, hidden ones
    inputs: tuple[str, ...]
    acceleration: sympy.Expr  # the force along a prescribed stroke
    rates: tuple[sympy.Expr, ...]  # of the hidden states
    values: tuple[float, ...]
    initial: tuple[float, ...]
    step: float  # [s]
    comments: tuple[str, ...]  # ASCII, a line each, nothing that could end a comment

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden states."""
        return self.states[2:]

    @property
    def state_rates(self) -> tuple[sympy.Expr, ...]:
        """Rates of all states."""
        import sympy

        return (sympy.Symbol("z_first"), self.acceleration, *self.rates)


def prepare_law_for_export(model: FittedLaw) -> LawForExport:
    """Prepare a model's law for export: names that code can have, values, and expressions."""
    import sympy

    law, parsed = model.law, model.law.parsed_equation
    columns = [name for name in law.inputs if name not in STROKE]
    columns += ["acceleration"] * (STROKE[2] in law.inputs)
    parameters, hidden = ascii_names("p_", law.parameters), ascii_names("h_", law.hidden)
    inputs = ascii_names("u_", columns)
    pairs = zip((*law.parameters, *law.hidden, *columns), (*parameters, *hidden, *inputs), strict=True)
    symbols = {sympy.Symbol(name): sympy.Symbol(safe) for name, safe in pairs}

    def plain(expression: sympy.Expr) -> sympy.Expr:
        return replace_steps_by_signs(expression.xreplace(symbols))

    if law.prescribed:
        symbols[sympy.Symbol("z_second")] = sympy.Symbol("u_acceleration")
    period = 1.0 if model.at_rest is None else model.at_rest.period
    period = min([period, *(2.0 * math.pi / cycle.frequency for cycle in model.cycles)])
    low, high = model.domain.get("height", (float("nan"), float("nan")))
    unit = model.coordinate_unit
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
        states=("z", "z_first", *hidden),
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


def docstring_lines(comments: Iterable[str]) -> str:
    """Comments as lines of a docstring in Python, which nothing in them ends."""
    return "\n".join(line.replace('"', "'") for line in comments)


def python_expression(expression: sympy.Expr) -> str:
    """Expression in Python, by functions of NumPy."""
    from sympy.printing.numpy import NumPyPrinter

    return str(NumPyPrinter({"fully_qualified_modules": True}).doprint(expression))


C_MATHS = """\
#include <math.h>

#ifndef M_PI
#define M_PI 3.14159265358979323846
#endif
#ifndef M_E
#define M_E 2.71828182845904523536
#endif
"""
C_ADVANCE = """
{linkage}void {name}_advance(const double *parameters, double *states, const double *inputs, double time)
{{
    const int steps = time > 0.0 ? (int)ceil(time / {name}_longest_step) : 0;
    const double step = steps ? time / steps : 0.0;
    double slopes[4][{guard}_STATES + 1], middle[{guard}_STATES + 1];
    for (int n = 0; n < steps; n++) {{  /* Runge and Kutta's method of fourth order */
        for (int stage = 0; stage < 4; stage++) {{
            const double part = stage == 0 ? 0.0 : stage == 3 ? step : 0.5 * step;
            for (int k = 0; k < {guard}_STATES; k++)
                middle[k] = states[k] + (stage ? part * slopes[stage - 1][k] : 0.0);
            {name}_rates(parameters, middle, inputs, slopes[stage]);
        }}
        for (int k = 0; k < {guard}_STATES; k++)
            states[k] += step / 6.0 * (slopes[0][k] + 2.0 * slopes[1][k] + 2.0 * slopes[2][k]
                                       + slopes[3][k]);
    }}
}}
"""
_C = """\
{comments}

#include <stddef.h>
{maths}
enum {{ MODEL_STATES = {count}, MODEL_INPUTS = {inputs}, MODEL_PARAMETERS = {parameter_count} }};

static const double model_parameters[] = {{ {parameters} }};
static const double model_initial[] = {{ {initial} }};
static const double model_longest_step = {step};  /* [s] */

/* Time derivatives of a state; inputs may be NULL where the law has none. */
static void model_rates(const double *parameters, const double *states, const double *inputs,
                        double *rates)
{{
{locals}{rates}}}

/* A state after some time [s] with the inputs held. */{advance}
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
    """C99 source of a model: rates, and `model_simulate`."""
    parts = prepare_law_for_export(model)
    return _C.format(
        maths=C_MATHS,
        advance=C_ADVANCE.format(linkage="static ", name="model", guard="MODEL"),
        comments="\n".join(f"/* {words} */" for words in parts.comments),
        count=len(parts.states),
        inputs=len(parts.inputs),
        parameter_count=len(parts.parameters),
        parameters=c_array_initialiser(parts.values),
        initial=c_array_initialiser(parts.initial),
        step=repr(parts.step),
        locals=c_local_variables(parts),
        rates=c_assignments("rates", parts.state_rates),
    )


def c_expression(expression: sympy.Expr) -> str:
    """Expression in C99."""
    from sympy.printing.c import C99CodePrinter

    printer = C99CodePrinter({"user_functions": {"max": "fmax", "min": "fmin"}})
    return str(printer.doprint(expression))


def c_array_initialiser(numbers: Sequence[float]) -> str:
    """Elements of an array in C, separated by commas; "0.0" where there is none."""
    return ", ".join(map(repr, numbers)) or "0.0"


def c_assignments(array: str, expressions: Iterable[sympy.Expr]) -> str:
    """Lines of C that fill an array."""
    return "".join(f"    {array}[{k}] = {c_expression(item)};\n" for k, item in enumerate(expressions))


def array_element_names(element: Any, arrays: Sequence[str], line: str, first: int = 0) -> str:
    """Lines that name each number of some arrays, which count from ``first``."""
    return "".join(
        line.format(name=name, array=array, index=first + k)
        for array in arrays
        for k, name in enumerate(getattr(element, array))
    )


def c_local_variables(element: Any) -> str:
    """Lines of C that name what the expressions of an element name."""
    arrays = ("inputs", "parameters", "states")
    named = array_element_names(element, arrays, "    const double {name} = {array}[{index}];\n")
    silent = array_element_names(element, arrays, "(void){name}; ")
    return f"{named}    (void)inputs; (void)parameters; (void)states; {silent.rstrip()}\n"


MATLAB_NAME = "  {name} = {array}({index});\n"
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

function found = rates(states, inputs)
{locals}  found = [{rates}];
end
"""


def matlab_source(model: FittedLaw, name: str = "damper_model") -> str:
    """MATLAB and Octave source of a function of that name, which its file must have too."""
    parts = prepare_law_for_export(model)
    lines = [f"  {name} = {value!r};\n" for name, value in zip(parts.parameters, parts.values, strict=True)]
    lines.append(array_element_names(parts, ("states", "inputs"), MATLAB_NAME, 1))
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
    """Lines of a Modelica model: parameters with values and units, inputs, states with starts and rates."""
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
    """Expression in Modelica: powers by ^, and pi and e as numbers."""
    import sympy

    result = expression.xreplace({sympy.pi: sympy.pi.evalf(17), sympy.E: sympy.E.evalf(17)})
    return str(sympy.sstr(result)).replace("**", "^").replace("Abs(", "abs(")


def modelica_unit(unit: str) -> str:
    """Return the unit as Modelica writes it; empty where it is a user's own word."""
    plain = unit.replace("^", "").replace("(m s2)", "(m.s2)").replace("(m2 s2)", "(m2.s2)")
    return plain if _UNIT.fullmatch(plain) else ""


_UNIT = re.compile(r"(1|kg|N|m|rad|s)(/(s2?|m|rad|\(m2?\.s2\)))?")
