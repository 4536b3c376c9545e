/* An instance of the model above, whatever version of FMI calls it.

   Value references: states from 0, inputs from 1000, parameters from 2000, rates of the states from
   3000, outputs from 4000, and the time. */

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { INPUTS = 1000, PARAMETERS = 2000, RATES = 3000, OUTPUTS = 4000, TIME = 5000 };
enum { ROWS = MODEL_STATES + MODEL_OUTPUTS, COLUMNS = MODEL_STATES + MODEL_INPUTS };

typedef enum { OK, Warning, Discard, Error, Fatal, Pending } Status;
typedef unsigned int Reference;
typedef struct {
    double state[MODEL_STATES + 1];
    double inputs[MODEL_INPUTS + 1];
    double parameters[MODEL_PARAMETERS + 1];
    double time;
} Instance;

static void reset(Instance *one)
{
    memset(one, 0, sizeof *one);
    for (int k = 0; k < MODEL_STATES; k++) one->state[k] = MODEL_START[k];
    for (int k = 0; k < MODEL_INPUTS; k++) one->inputs[k] = model_start_inputs[k];
    for (int k = 0; k < MODEL_PARAMETERS; k++) one->parameters[k] = model_parameters[k];
}

static Instance *create(const char *token)
{
    Instance *one = strcmp(token, MODEL_GUID) ? NULL : malloc(sizeof *one);
    if (one) reset(one);
    return one;
}

static int index_of(Reference which, Reference first, int count)
{ return which >= first && which - first < (Reference)count ? (int)(which - first) : -1; }

static double *place(Instance *one, Reference which)
{
    int k;
    if ((k = index_of(which, 0, MODEL_STATES)) >= 0) return one->state + k;
    if ((k = index_of(which, INPUTS, MODEL_INPUTS)) >= 0) return one->inputs + k;
    if ((k = index_of(which, PARAMETERS, MODEL_PARAMETERS)) >= 0) return one->parameters + k;
    return which == TIME ? &one->time : NULL;
}

static Status get(Instance *one, const Reference which[], size_t n, double value[])
{
    double rates[MODEL_STATES + 1], outputs[MODEL_OUTPUTS + 1];
    model_rates(one->parameters, one->state, one->inputs, rates);
    model_outputs(one->parameters, one->state, one->inputs, outputs);
    for (size_t k = 0; k < n; k++) {
        const double *here = place(one, which[k]);
        const int rate = index_of(which[k], RATES, MODEL_STATES);
        const int output = index_of(which[k], OUTPUTS, MODEL_OUTPUTS);
        if (!here && rate < 0 && output < 0) return Error;
        value[k] = here ? *here : rate >= 0 ? rates[rate] : outputs[output];
    }
    return OK;
}

static Status set(Instance *one, const Reference which[], size_t n, const double value[])
{
    for (size_t k = 0; k < n; k++) {
        double *here = which[k] == TIME ? NULL : place(one, which[k]);
        if (!here) return Error;
        *here = value[k];
    }
    return OK;
}

static Status advance(Instance *one, double now, double step)
{
    model_advance(one->parameters, one->state, one->inputs, step);
    one->time = now + step;
    for (int k = 0; k < MODEL_STATES; k++)
        if (!isfinite(one->state[k])) return Error;
    return OK;
}

/* Derivatives along a seed of states and inputs. */
static Status directional(Instance *one, const Reference unknowns[], size_t n,
                          const Reference knowns[], size_t m, const double seed[], double result[])
{
    double rows[ROWS * COLUMNS + 1];
    if (!MODEL_JACOBIAN) return Error;
    model_jacobian(one->parameters, one->state, one->inputs, rows);
    for (size_t i = 0; i < n; i++) {
        const int state = index_of(unknowns[i], 0, MODEL_STATES);
        const int output = index_of(unknowns[i], OUTPUTS, MODEL_OUTPUTS);
        const int row = output >= 0 ? MODEL_STATES + output : index_of(unknowns[i], RATES, MODEL_STATES);
        if (state < 0 && row < 0) return Error;
        result[i] = 0.0;
        for (size_t j = 0; j < m; j++) {
            const int input = index_of(knowns[j], INPUTS, MODEL_INPUTS);
            const int column = input >= 0 ? MODEL_STATES + input : index_of(knowns[j], 0, MODEL_STATES);
            if (column < 0) return Error;
            result[i] += seed[j] * (state >= 0 ? column == state : rows[row * COLUMNS + column]);
        }
    }
    return OK;
}

static Status get_states(Instance *one, double states[], size_t n)
{ for (size_t k = 0; k < n && k < MODEL_STATES; k++) states[k] = one->state[k]; return OK; }

static Status set_states(Instance *one, const double states[], size_t n)
{ for (size_t k = 0; k < n && k < MODEL_STATES; k++) one->state[k] = states[k]; return OK; }

static Status get_rates(Instance *one, double rates[], size_t n)
{
    double all[MODEL_STATES + 1];
    model_rates(one->parameters, one->state, one->inputs, all);
    for (size_t k = 0; k < n && k < MODEL_STATES; k++) rates[k] = all[k];
    return OK;
}

static Status ones(double nominals[], size_t n)
{ for (size_t k = 0; k < n; k++) nominals[k] = 1.0; return OK; }

static Status keep(Instance *one, void **kept)
{
    if (!*kept) *kept = malloc(sizeof(Instance));
    if (!*kept) return Error;
    memcpy(*kept, one, sizeof(Instance));
    return OK;
}

static Status drop(void **kept) { free(*kept); *kept = NULL; return OK; }
