"""A model as a function in C99, which needs the standard library alone."""

from __future__ import annotations

from reduced_models.models.export_parts import ExportParts, export_parts
from reduced_models.models.fitted_law import FittedLaw

_TEMPLATE = """\
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
    const double shift = {shift}, scale = {scale};  /* height = shift + scale z */
    const double z = (state[0] - shift) / scale, z_first = state[1] / scale;
{locals}    (void)z; (void)z_first; (void)parameters; (void)inputs;
    rates[0] = state[1];
    rates[1] = scale * ({acceleration});
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
    from sympy.printing.c import C99CodePrinter

    parts = export_parts(model)
    printer = C99CodePrinter({"user_functions": {"max": "fmax", "min": "fmin"}})

    def array(numbers: tuple[float, ...]) -> str:
        return ", ".join(map(repr, numbers)) or "0.0"

    rates = [
        f"    rates[{2 + k}] = {printer.doprint(rate)};\n" for k, rate in enumerate(parts.rates)
    ]
    return _TEMPLATE.format(
        comments="\n".join(f"/* {words} */" for words in parts.comments),
        states=2 + len(parts.hidden),
        inputs=len(parts.inputs),
        count=len(parts.parameters),
        parameters=array(parts.values),
        initial=array(parts.initial),
        step=repr(parts.step),
        shift=repr(float(model.map.shift)),
        scale=repr(float(model.map.scale)),
        locals="".join(_locals(parts)),
        acceleration=printer.doprint(parts.acceleration),
        hidden="".join(rates),
    )


def _locals(parts: ExportParts) -> list[str]:
    """Parameters, hidden states and inputs by their names."""
    groups = (
        (parts.parameters, "parameters", 0), (parts.hidden, "state", 2), (parts.inputs, "inputs", 0)
    )  # fmt: skip
    return [
        f"    const double {name} = {array}[{first + k}];\n"
        for names, array, first in groups
        for k, name in enumerate(names)
    ]
