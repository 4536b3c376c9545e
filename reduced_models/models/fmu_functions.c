/* FMI 2.0 for co-simulation around the model above: what the standard asks for, and no more. */

#include <stdlib.h>
#include <string.h>

typedef void *fmi2Component, *fmi2FMUstate, *fmi2Environment;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;
typedef enum { OK, Warning, Discard, Error, Fatal, Pending } fmi2Status;

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Value references: states from 0, inputs from 1000, parameters from 2000. */
enum { INPUTS = 1000, PARAMETERS = 2000 };

typedef struct {
    double state[MODEL_STATES];
    double inputs[MODEL_INPUTS + 1];
    double parameters[MODEL_PARAMETERS + 1];
} Instance;

static void reset(Instance *one)
{
    memset(one, 0, sizeof *one);
    for (int k = 0; k < MODEL_STATES; k++) one->state[k] = model_initial[k];
    for (int k = 0; k < MODEL_PARAMETERS; k++) one->parameters[k] = model_parameters[k];
}

static double *place(Instance *one, fmi2ValueReference which)
{
    if (which < MODEL_STATES) return one->state + which;
    if (which >= INPUTS && which - INPUTS < MODEL_INPUTS) return one->inputs + (which - INPUTS);
    if (which >= PARAMETERS && which - PARAMETERS < MODEL_PARAMETERS)
        return one->parameters + (which - PARAMETERS);
    return NULL;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String a[])
{ (void)c; (void)on; (void)n; (void)a; return OK; }

EXPORT fmi2Component fmi2Instantiate(fmi2String name, int kind, fmi2String guid, fmi2String resources,
                                     const void *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)name; (void)resources; (void)functions; (void)visible; (void)logging;
    if (kind != 1 || strcmp(guid, MODEL_GUID)) return NULL;
    Instance *one = malloc(sizeof *one);
    if (one) reset(one);
    return one;
}
EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }
EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
                                      fmi2Real start, fmi2Boolean ends, fmi2Real stop)
{ (void)c; (void)tolerant; (void)tolerance; (void)start; (void)ends; (void)stop; return OK; }
EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return OK; }
EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return OK; }
EXPORT fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return OK; }
EXPORT fmi2Status fmi2Reset(fmi2Component c) { reset(c); return OK; }

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, fmi2Real value[])
{
    for (size_t k = 0; k < n; k++) {
        const double *here = place(c, which[k]);
        if (!here) return Error;
        value[k] = *here;
    }
    return OK;
}
EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference which[], size_t n, const fmi2Real value[])
{
    for (size_t k = 0; k < n; k++) {
        double *here = place(c, which[k]);
        if (!here) return Error;
        *here = value[k];
    }
    return OK;
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean final)
{
    Instance *one = c;
    (void)now; (void)final;
    model_advance(one->parameters, one->state, one->inputs, step);
    for (int k = 0; k < MODEL_STATES; k++)
        if (!isfinite(one->state[k])) return Error;
    return OK;
}
EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return Error; }

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *kept)
{
    if (!*kept) *kept = malloc(sizeof(Instance));
    if (!*kept) return Error;
    memcpy(*kept, c, sizeof(Instance));
    return OK;
}
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate kept)
{ memcpy(c, kept, sizeof(Instance)); return OK; }
EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *kept)
{ (void)c; free(*kept); *kept = NULL; return OK; }

/* What a model of real numbers has not. */
#define NONE(name, ...) EXPORT fmi2Status name(fmi2Component c, __VA_ARGS__) { (void)c; return Error; }
#define UNNAMED const fmi2ValueReference a[], size_t n
NONE(fmi2GetInteger, UNNAMED, fmi2Integer v[])
NONE(fmi2SetInteger, UNNAMED, const fmi2Integer v[])
NONE(fmi2GetBoolean, UNNAMED, fmi2Boolean v[])
NONE(fmi2SetBoolean, UNNAMED, const fmi2Boolean v[])
NONE(fmi2GetString, UNNAMED, fmi2String v[])
NONE(fmi2SetString, UNNAMED, const fmi2String v[])
NONE(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *size)
NONE(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t size)
NONE(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t size, fmi2FMUstate *s)
NONE(fmi2GetDirectionalDerivative, UNNAMED, const fmi2ValueReference b[], size_t m, const fmi2Real x[], fmi2Real y[])
NONE(fmi2SetRealInputDerivatives, UNNAMED, const fmi2Integer o[], const fmi2Real v[])
NONE(fmi2GetRealOutputDerivatives, UNNAMED, const fmi2Integer o[], fmi2Real v[])
NONE(fmi2GetStatus, int kind, fmi2Status *s)
NONE(fmi2GetRealStatus, int kind, fmi2Real *v)
NONE(fmi2GetIntegerStatus, int kind, fmi2Integer *v)
NONE(fmi2GetBooleanStatus, int kind, fmi2Boolean *v)
NONE(fmi2GetStringStatus, int kind, fmi2String *v)
