"""What JAX compiles in a process is counted, with the processor time of the process."""

from __future__ import annotations

from benchmarks.compilations import count_compilations

ONE = "from reduced_models.jax_setup import jax; jax.jit(lambda x: x + 1.0)({0})"
BOTH = f"{ONE.format('1.0')}; jax.jit(lambda x: x - 1.0)(jax.numpy.ones(3))"


def test_programs_are_counted() -> None:
    few, more = (count_compilations(("-c", code)) for code in (ONE.format("1.0"), BOTH))
    assert 1 <= few.counts["compiling"] < more.counts["compiling"]
    assert 0.0 < more.seconds["compiling"] < more.processor
    assert more.longest[0][0] >= more.longest[-1][0]
