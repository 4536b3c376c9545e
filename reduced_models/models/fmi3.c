
/* FMI 3.0 around it, for model exchange and co-simulation. */

typedef const char *Text;

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT Status fmi3SetDebugLogging(void *c, bool on, size_t n, const Text a[])
{ (void)c; (void)on; (void)n; (void)a; return OK; }

EXPORT void *fmi3InstantiateModelExchange(Text name, Text token, Text resources, bool visible,
                                          bool logging, void *environment, void *message)
{
    (void)name; (void)resources; (void)visible; (void)logging; (void)environment; (void)message;
    return create(token);
}
EXPORT void *fmi3InstantiateCoSimulation(Text name, Text token, Text resources, bool visible,
                                         bool logging, bool events, bool early,
                                         const Reference required[], size_t n, void *environment,
                                         void *message, void *update)
{
    (void)name; (void)resources; (void)visible; (void)logging; (void)events; (void)early;
    (void)required; (void)n; (void)environment; (void)message; (void)update;
    return create(token);
}
EXPORT void *fmi3InstantiateScheduledExecution(Text name, Text token, Text resources, bool visible,
                                               bool logging, void *environment, void *message,
                                               void *update, void *lock, void *unlock)
{
    (void)name; (void)token; (void)resources; (void)visible; (void)logging; (void)environment;
    (void)message; (void)update; (void)lock; (void)unlock;
    return NULL;
}
EXPORT void fmi3FreeInstance(void *c) { free(c); }
EXPORT Status fmi3EnterInitializationMode(void *c, bool tolerant, double tolerance, double start,
                                          bool ends, double stop)
{ (void)tolerant; (void)tolerance; (void)ends; (void)stop; ((Instance *)c)->time = start; return OK; }
EXPORT Status fmi3ExitInitializationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3EnterEventMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3EnterConfigurationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3ExitConfigurationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3EnterStepMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3Terminate(void *c) { (void)c; return OK; }
EXPORT Status fmi3Reset(void *c) { reset(c); return OK; }
EXPORT Status fmi3GetFloat64(void *c, const Reference which[], size_t n, double value[], size_t m)
{ return m == n ? get(c, which, n, value) : Error; }
EXPORT Status fmi3SetFloat64(void *c, const Reference which[], size_t n, const double value[], size_t m)
{ return m == n ? set(c, which, n, value) : Error; }
EXPORT Status fmi3GetFMUState(void *c, void **kept) { return keep(c, kept); }
EXPORT Status fmi3SetFMUState(void *c, void *kept) { memcpy(c, kept, sizeof(Instance)); return OK; }
EXPORT Status fmi3FreeFMUState(void *c, void **kept) { (void)c; return drop(kept); }
EXPORT Status fmi3GetDirectionalDerivative(void *c, const Reference unknowns[], size_t n,
                                           const Reference knowns[], size_t m, const double seed[],
                                           size_t seeds, double result[], size_t results)
{
    return seeds == m && results == n ? directional(c, unknowns, n, knowns, m, seed, result) : Error;
}
EXPORT Status fmi3EvaluateDiscreteStates(void *c) { (void)c; return OK; }
EXPORT Status fmi3UpdateDiscreteStates(void *c, bool *again, bool *ends, bool *nominals, bool *values,
                                       bool *timed, double *time)
{ (void)c; (void)time; *again = *ends = *nominals = *values = *timed = false; return OK; }

EXPORT Status fmi3DoStep(void *c, double now, double step, bool final, bool *event, bool *ends,
                         bool *early, double *reached)
{
    (void)final; *event = *ends = *early = false; *reached = now + step;
    return advance(c, now, step);
}

EXPORT Status fmi3EnterContinuousTimeMode(void *c) { (void)c; return OK; }
EXPORT Status fmi3CompletedIntegratorStep(void *c, bool final, bool *event, bool *ends)
{ (void)c; (void)final; *event = *ends = false; return OK; }
EXPORT Status fmi3SetTime(void *c, double time) { ((Instance *)c)->time = time; return OK; }
EXPORT Status fmi3SetContinuousStates(void *c, const double states[], size_t n)
{ return set_states(c, states, n); }
EXPORT Status fmi3GetContinuousStates(void *c, double states[], size_t n)
{ return get_states(c, states, n); }
EXPORT Status fmi3GetContinuousStateDerivatives(void *c, double rates[], size_t n)
{ return get_rates(c, rates, n); }
EXPORT Status fmi3GetEventIndicators(void *c, double indicators[], size_t n)
{ (void)c; (void)indicators; (void)n; return OK; }
EXPORT Status fmi3GetNominalsOfContinuousStates(void *c, double nominals[], size_t n)
{ (void)c; return ones(nominals, n); }
EXPORT Status fmi3GetNumberOfEventIndicators(void *c, size_t *n) { (void)c; *n = 0; return OK; }
EXPORT Status fmi3GetNumberOfContinuousStates(void *c, size_t *n)
{ (void)c; *n = MODEL_STATES; return OK; }

/* Functions that a model of real numbers does not have. */
#define NONE(name, ...) EXPORT Status name(void *c, __VA_ARGS__) { (void)c; return Error; }
#define UNNAMED const Reference a[], size_t n
#define TYPE(name, type) NONE(fmi3Get##name, UNNAMED, type v[], size_t m) \
                         NONE(fmi3Set##name, UNNAMED, const type v[], size_t m)
TYPE(Float32, float)
TYPE(Int8, int8_t)
TYPE(UInt8, uint8_t)
TYPE(Int16, int16_t)
TYPE(UInt16, uint16_t)
TYPE(Int32, int32_t)
TYPE(UInt32, uint32_t)
TYPE(Int64, int64_t)
TYPE(UInt64, uint64_t)
TYPE(Boolean, bool)
TYPE(String, Text)
NONE(fmi3GetBinary, UNNAMED, size_t sizes[], const uint8_t *v[], size_t m)
NONE(fmi3SetBinary, UNNAMED, const size_t sizes[], const uint8_t *const v[], size_t m)
NONE(fmi3GetClock, UNNAMED, bool v[])
NONE(fmi3SetClock, UNNAMED, const bool v[])
NONE(fmi3GetNumberOfVariableDependencies, Reference a, size_t *n)
NONE(fmi3GetVariableDependencies, Reference a, size_t i[], Reference b[], size_t j[], int kinds[], size_t n)
NONE(fmi3SerializedFMUStateSize, void *s, size_t *size)
NONE(fmi3SerializeFMUState, void *s, uint8_t b[], size_t size)
NONE(fmi3DeserializeFMUState, const uint8_t b[], size_t size, void **s)
NONE(fmi3GetAdjointDerivative, UNNAMED, const Reference b[], size_t m, const double x[], size_t p, double y[], size_t q)
NONE(fmi3GetIntervalDecimal, UNNAMED, double v[], int q[])
NONE(fmi3GetIntervalFraction, UNNAMED, uint64_t v[], uint64_t r[], int q[])
NONE(fmi3GetShiftDecimal, UNNAMED, double v[])
NONE(fmi3GetShiftFraction, UNNAMED, uint64_t v[], uint64_t r[])
NONE(fmi3SetIntervalDecimal, UNNAMED, const double v[])
NONE(fmi3SetIntervalFraction, UNNAMED, const uint64_t v[], const uint64_t r[])
NONE(fmi3SetShiftDecimal, UNNAMED, const double v[])
NONE(fmi3SetShiftFraction, UNNAMED, const uint64_t v[], const uint64_t r[])
NONE(fmi3GetOutputDerivatives, UNNAMED, const int32_t o[], double v[], size_t m)
NONE(fmi3ActivateModelPartition, Reference clock, double time)
