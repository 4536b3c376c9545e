"""Export of a model to C99: its motion, or (with a header) the force between two bodies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    for (int n = 0; n < steps; n++) {{  /* fourth-order Runge-Kutta method */
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

/* Time derivatives of a state; inputs may be NULL if the law has none. */
static void model_rates(const double *parameters, const double *states, const double *inputs,
                        double *rates)
{{
{locals}{rates}}}

/* A state after some time [s] with the inputs held. */{advance}
/* Heights at increasing times, from a state; inputs has MODEL_INPUTS numbers per time. */
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
    """Return the C99 source of a model, with the function `model_simulate`."""
    parts = prepare_law_for_export(model)
    return _C.format(
        maths=C_MATHS,
        advance=C_ADVANCE.format(linkage="static ", name="model", guard="MODEL"),
        comments="\n".join(f"/* {words} */" for words in parts.comments),
        count=len(parts.states),
        inputs=len(parts.inputs),
        parameter_count=len(parts.parameters),
        parameters=c_array_elements(parts.values),
        initial=c_array_elements(parts.initial),
        step=repr(parts.step),
        locals=c_local_variables(parts),
        rates=c_assignments("rates", parts.state_rates),
    )


def c_expression(expression: sympy.Expr) -> str:
    """Return an expression in C99."""
    from sympy.printing.c import C99CodePrinter

    printer = C99CodePrinter({"user_functions": {"max": "fmax", "min": "fmin"}})
    return str(printer.doprint(expression))


def c_array_elements(numbers: Sequence[float]) -> str:
    """Return the elements of an array in C, separated by commas; "0.0" for an empty array."""
    return ", ".join(map(repr, numbers)) or "0.0"


def c_assignments(array: str, expressions: Iterable[sympy.Expr]) -> str:
    """Return lines of C that assign expressions to the elements of an array."""
    return "".join(f"    {array}[{k}] = {c_expression(item)};\n" for k, item in enumerate(expressions))


def c_local_variables(element: Any) -> str:
    """Return lines of C that declare the variables of a model's expressions."""
    arrays = ("inputs", "parameters", "states")
    named = name_array_elements(element, arrays, "    const double {name} = {array}[{index}];\n")
    silent = name_array_elements(element, arrays, "(void){name}; ")
    return f"{named}    (void)inputs; (void)parameters; (void)states; {silent.rstrip()}\n"


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

/* Force {direction}. */
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


def port_c_header_and_source(port: ForcePort, name: str) -> tuple[str, str]:
    """Return the C99 header and source of a bed; ``name`` is the prefix of all declared names."""
    parts = prepare_port_for_export(port)
    force, *rates = parts.outputs
    words = {
        "name": name,
        "guard": name.upper(),
        "step": repr(parts.law.step),
        "comments": "\n".join(f"/* {line} */" for line in parts.comments),
        "direction": parts.direction,
        "states": ", ".join(parts.states) or "none",
        "inputs": ", ".join(["height [m]", "velocity [m/s]", *parts.law.inputs]),
        "names": ", ".join(parameter_names_with_units(parts)),
        "n_states": len(parts.states),
        "n_inputs": len(parts.inputs),
        "n_parameters": len(parts.parameters),
        "parameters": c_array_elements(parts.values),
        "start": c_array_elements(parts.start),
        "locals": c_local_variables(parts),
        "force": c_expression(force),
        "rates": c_assignments("rates", rates),
        "maths": C_MATHS,
        "advance": C_ADVANCE.format(linkage="", name=name, guard=name.upper()),
    }
    return _HEADER.format(**words), _BODY.format(**words)


def write_c(model: FittedLaw | ForcePort, path: Path, _: int) -> str:
    """Write a model as C99, and for a `ForcePort` also a header."""
    if not isinstance(model, ForcePort):
        write_text(path, c_source(model))
        return "C99"
    require_function_name(path)
    header, body = port_c_header_and_source(model, path.stem)
    write_text(path, f'#include "{path.stem}.h"\n{body}')
    write_text(path.with_suffix(".h"), header)
    return "C99 with its header"
