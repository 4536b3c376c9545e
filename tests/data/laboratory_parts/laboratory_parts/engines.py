"""An engine: the compiled loop, and a count of its calls."""

from granular.run import engines

CALLS = []


def advance(system, state, ticks):
    """Advance by the compiled loop."""
    CALLS.append(ticks)
    return engines.advance_with_compiled_loop(system, state, ticks)
