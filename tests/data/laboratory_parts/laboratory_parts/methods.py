"""An integration method."""

from granular import Method

BENCH_VERLET = Method("bench-verlet", 2, kicks=(0.5, 0.5), drifts=(1,))
