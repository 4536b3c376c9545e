
/* FMI 2.0 around it, for model exchange and co-simulation. */

typedef int Boolean;
typedef const char *Text;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT Status fmi2SetDebugLogging(void *c, Boolean on, size_t n, const Text a[])
{ (void)c; (void)on; (void)n; (void)a; return OK; }

EXPORT void *fmi2Instantiate(Text name, int kind, Text guid, Text resources, const void *functions,
                             Boolean visible, Boolean logging)
{
    (void)name; (void)kind; (void)resources; (void)functions; (void)visible; (void)logging;
    return create(guid);
}
EXPORT void fmi2FreeInstance(void *c) { free(c); }
EXPORT Status fmi2SetupExperiment(void *c, Boolean tolerant, double tolerance, double start,
                                  Boolean ends, double stop)
{ (void)tolerant; (void)tolerance; (void)ends; (void)stop; ((Instance *)c)->time = start; return OK; }
EXPORT Status fmi2EnterInitializationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2ExitInitializationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2Terminate(void *c) { (void)c; return OK; }
EXPORT Status fmi2Reset(void *c) { reset(c); return OK; }
EXPORT Status fmi2GetReal(void *c, const Reference which[], size_t n, double value[])
{ return get(c, which, n, value); }
EXPORT Status fmi2SetReal(void *c, const Reference which[], size_t n, const double value[])
{ return set(c, which, n, value); }
EXPORT Status fmi2GetFMUstate(void *c, void **kept) { return keep(c, kept); }
EXPORT Status fmi2SetFMUstate(void *c, void *kept) { memcpy(c, kept, sizeof(Instance)); return OK; }
EXPORT Status fmi2FreeFMUstate(void *c, void **kept) { (void)c; return drop(kept); }
EXPORT Status fmi2GetDirectionalDerivative(void *c, const Reference unknowns[], size_t n,
                                           const Reference knowns[], size_t m, const double seed[],
                                           double result[])
{ return directional(c, unknowns, n, knowns, m, seed, result); }

EXPORT Status fmi2DoStep(void *c, double now, double step, Boolean final)
{ (void)final; return advance(c, now, step); }
EXPORT Status fmi2CancelStep(void *c) { (void)c; return Error; }

typedef struct { Boolean again, ends, nominals, values, timed; double time; } EventInfo;
EXPORT Status fmi2EnterEventMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2NewDiscreteStates(void *c, EventInfo *info)
{ (void)c; memset(info, 0, sizeof *info); return OK; }
EXPORT Status fmi2EnterContinuousTimeMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2CompletedIntegratorStep(void *c, Boolean final, Boolean *event, Boolean *ends)
{ (void)c; (void)final; *event = 0; *ends = 0; return OK; }
EXPORT Status fmi2SetTime(void *c, double time) { ((Instance *)c)->time = time; return OK; }
EXPORT Status fmi2SetContinuousStates(void *c, const double states[], size_t n)
{ return set_states(c, states, n); }
EXPORT Status fmi2GetContinuousStates(void *c, double states[], size_t n)
{ return get_states(c, states, n); }
EXPORT Status fmi2GetDerivatives(void *c, double rates[], size_t n) { return get_rates(c, rates, n); }
EXPORT Status fmi2GetEventIndicators(void *c, double indicators[], size_t n)
{ (void)c; (void)indicators; (void)n; return OK; }
EXPORT Status fmi2GetNominalsOfContinuousStates(void *c, double nominals[], size_t n)
{ (void)c; return ones(nominals, n); }

/* Functions that a model of real numbers does not have. */
#define NONE(name, ...) EXPORT Status name(void *c, __VA_ARGS__) { (void)c; return Error; }
#define UNNAMED const Reference a[], size_t n
NONE(fmi2GetInteger, UNNAMED, int v[])
NONE(fmi2SetInteger, UNNAMED, const int v[])
NONE(fmi2GetBoolean, UNNAMED, Boolean v[])
NONE(fmi2SetBoolean, UNNAMED, const Boolean v[])
NONE(fmi2GetString, UNNAMED, Text v[])
NONE(fmi2SetString, UNNAMED, const Text v[])
NONE(fmi2SerializedFMUstateSize, void *s, size_t *size)
NONE(fmi2SerializeFMUstate, void *s, char b[], size_t size)
NONE(fmi2DeSerializeFMUstate, const char b[], size_t size, void **s)
NONE(fmi2SetRealInputDerivatives, UNNAMED, const int o[], const double v[])
NONE(fmi2GetRealOutputDerivatives, UNNAMED, const int o[], double v[])
NONE(fmi2GetStatus, int kind, Status *s)
NONE(fmi2GetRealStatus, int kind, double *v)
NONE(fmi2GetIntegerStatus, int kind, int *v)
NONE(fmi2GetBooleanStatus, int kind, Boolean *v)
NONE(fmi2GetStringStatus, int kind, Text *v)
