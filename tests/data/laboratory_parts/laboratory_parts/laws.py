"""A law of motion and a force law."""

from reduced_models import Law

BENCH_SPRING = Law(
    "bench-spring",
    "z'' + 2*lam*z' + k*(z - rest) = 0",
    positive=("k",),
    units={"lam": "1/s", "k": "1/s^2", "rest": "m"},
    source="the bench",
)
BENCH_DAMPER = Law("bench-damper", "force = c*z'", positive=("c",), units={"c": "N s/m"}, source="the bench")
