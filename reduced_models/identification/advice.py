"""What to try where even the best law is poor."""

from __future__ import annotations

from reduced_models.identification.candidates import unused_columns
from reduced_models.identification.data import IdentificationData

POOR = 0.05
"""Held-out error, in rms swings, from which a law is poor where the noise is less than that."""
_NOISE_TIMES = 3.0
_USEFUL_TURNS = 4.0  # periods of a record, below which it says little of a law


def advice(found: IdentificationData, discovery: str | None) -> tuple[str, ...]:
    """In words, the most promising first; nothing where the best law is good.

    ``discovery`` is the method that was tried already, if any.
    """
    best = found.comparison.rows[0]
    noise = found.comparison.noise
    if best.error < max(POOR, _NOISE_TIMES * noise):
        return ()
    record, model = found.record, found.best
    words = [
        f"even the best law, {best.name}, misses what it has not seen by "
        f"{100 * best.error:.3g} % of the swing"
    ]
    columns = unused_columns(record, tuple(one.law for one in found.models))
    if found.run is None and columns:
        words.append(f"drive the laws by a column that was not used: --input {columns[0]}")
    if model.at_rest is not None:
        turns = float(record.time[-1] - record.time[0]) / model.at_rest.period
        if turns < _USEFUL_TURNS:
            words.append(f"record longer: {turns:.2g} periods say little of a law")
    words.append(
        "look at the record (python -m reduced_models look FILE) and leave out its first moments, "
        "or what lies in the noise: --between in a record.toml"
    )
    if discovery is None:
        words.append("let a law be discovered: --discover sindy")
    words += [
        "try a law with memory, as hysteresis has: --law bouc-wen",
        "write down a law of your own: --law \"z'' + c*z' + k*(z - r)**3 = 0\"",
    ]
    return tuple(words)
