"""An engine that calls the compiled time loop and counts its calls."""

from granular.run import engines

CALLS = []


def advance(system, state, ticks):
    """Advance by the compiled loop."""
    CALLS.append(ticks)
    return engines.advance_with_compiled_loop(system, state, ticks)
