"""Records as users hand them over, with weights and noise of their samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.record import PandasOrXarray, PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models.records.sources import read_record

RecordLike = (
    PistonRecord | PandasOrXarray | str | Path | Mapping[str, np.ndarray] | tuple[np.ndarray, np.ndarray]
)
"""A record, a table of one, the name of its file, or its times and heights."""


def record_from_table(source: Any) -> Any:
    """Record in a table, in a mapping of names to arrays or in a pair (time, height); else the source."""
    if isinstance(source, tuple) and len(source) == 2 and all(map(_is_plain_array, source)):
        return PistonRecord(*source)
    is_table = hasattr(source, "equals") or isinstance(source, Mapping)
    return PistonRecord.from_table(source) if is_table else source


def _is_plain_array(values: Any) -> bool:
    """Return whether values are one column, and no table of a column."""
    return np.ndim(values) == 1 and not hasattr(values, "equals")


def read_given_record(source: Any) -> Any:
    """Record in a file, as `read_record` reads it, or in a table; anything else as it is."""
    return read_record(source) if isinstance(source, str | Path) else record_from_table(source)


def list_of_records(record: Any) -> list[PistonRecord]:
    """One record, file or table, or a sequence of them, as a list of records."""
    if isinstance(single := read_given_record(record), PistonRecord):
        return [single]
    if isinstance(record, Sequence):
        records = [read_given_record(item) for item in record]
        if not records:
            raise InputError("there is no record to fit; give at least one")
        if all(isinstance(item, PistonRecord) for item in records):
            return records
    kind = type(record).__name__
    raise InputError(
        f"a {kind} is no record; give a file's name, (time, height), a table, or a PistonRecord, such as "
        "read_record(path) gives"
    )


def refuse_prescribed_strokes(records: Sequence[PistonRecord], action: str) -> None:
    """Refuse records of a force along a prescribed stroke."""
    for record in records:
        if record.measured == "force":
            raise RecordError(
                f"{action} is of free or driven motions, and the stroke of this record is prescribed; "
                'for a law of its force give target="force" (--target force)'
            )


def weights_and_noise(
    records: Sequence[PistonRecord], weights: Any, noise: Any
) -> list[tuple[np.ndarray | None, float | None]]:
    """Weights (n,) of each record's residuals, and the noise [m] of one with the weight 1."""
    if weights is not None and noise is not None and np.ndim(noise) > 0:
        raise InputError("noise of each sample gives their weights; leave weights out")
    several = len(records) > 1
    both: list[tuple[np.ndarray | None, float | None]] = []
    for k, record in enumerate(records):
        weights_of_record = _option_of_record("weights", weights, k, record, several=several)
        noise_of_record = _option_of_record("noise", noise, k, record, several=several)
        if noise_of_record is None or noise_of_record.ndim == 0:
            level = None if noise_of_record is None else float(noise_of_record)
            both.append((weights_of_record, level))
        else:
            level = float(1.0 / np.sqrt((noise_of_record**-2.0).mean()))
            both.append((level / noise_of_record, level))
    return both


def _option_of_record(
    what: str, given: Any, k: int, record: PistonRecord, *, several: bool
) -> np.ndarray | None:
    if given is None:
        return None
    try:
        own = np.asarray(given[k] if several and np.ndim(given) != 0 else given, dtype=np.float64)
    except (TypeError, ValueError, IndexError):
        own = np.array(np.nan)
    shapes = [record.time.shape] if what == "weights" else [(), record.time.shape]
    if own.shape not in shapes or not np.isfinite(own).all() or not (own > 0.0).all():
        raise InputError(
            f"{what}: give positive numbers, one a sample ({len(record)})"
            + (", or one for all" if what == "noise" else "")
            + (", for each record" if several else "")
        )
    return own
