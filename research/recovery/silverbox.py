"""The Silverbox benchmark: an electronic Duffing oscillator under a force.

The record (T. Wigren, J. Schoukens 2013, doi:10.23919/ECC.2013.6669201; available from
https://www.nonlinearbenchmark.org) has 131,072 samples at 610.35 Hz. An arrow of growing noise, of 40,400
samples, precedes ten odd multisines. Laws are fitted to nine of these, and tested by a free run over the
tenth and over the arrow, with and without the part that exceeds the amplitudes of the fit. The data are not
part of this package.
"""

from __future__ import annotations

import csv
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.blocks import Table
from granular.shared.errors import InputError, sanitize
from granular.shared.files import read_text
from reduced_models.records.inputs import input_column

SAMPLING = 1e7 / 2**14
"""[Hz]"""
ARROW = 40_400
"""Number of samples of the arrow."""
_MOST_BYTES = 2**26
_TEST = 8192  # number of samples at the end: the tenth multisine
_WASHED_OUT = 50  # number of samples at the start of a part without score, as the benchmark requires
_SMALL_ARROW = 31_000  # number of samples of the arrow within the fitted amplitudes
LAWS = {
    "Duffing": "z'' + c*z' + k*z + b*z**3 = g*force + f",
    "with z^2 and z^2 z'": "z'' + c*z' + k*z + a*z**2 + b*z**3 + d*z**2*z' = g*force + f",
}


def silverbox(path: str | Path) -> dict[str, Any]:
    """Fit two laws to a file with the columns V1 and V2 [V]; free-run errors in millivolts.

    Raises
    ------
    InputError
        If the file does not hold the benchmark's record.
    """
    from reduced_models.fitting.fit import fit

    force, height = _read(Path(path))
    clock = np.arange(len(force)) / SAMPLING
    first = next(k for k in range(ARROW, len(force)) if abs(force[k]) > 1e-2)
    training = _part(clock, height, force, first, len(force) - _TEST)
    tests = {
        "multisine": _part(clock, height, force, len(force) - _TEST, len(force)),
        "arrow": _part(clock, height, force, 0, ARROW),
        "arrow, no extrapolation": _part(clock, height, force, 0, _SMALL_ARROW),
    }
    rows = []
    for name, law in LAWS.items():
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = fit(training, law, test_fraction=0.1)
        seconds = time.perf_counter() - begun
        errors = {}
        for part, record in tests.items():
            inputs = {"force": input_column(record, "force")}
            start, speed = (float(record.height[0]), float(np.gradient(record.height, record.time)[0]))
            run = model.simulate(record.time, z0=start, v0=speed, inputs=inputs)
            left = (run.height - record.height)[_WASHED_OUT:]
            errors[part] = 1e3 * float(np.sqrt((left**2).mean()))
        rows.append(
            {
                "law": name,
                "interpolation": model.input_interpolation,
                "seconds": seconds,
                "parameters": dict(model.parameters),
                "errors": errors,
            }
        )
    return {"rows": rows}


def _part(clock: np.ndarray, height: np.ndarray, force: np.ndarray, start: int, stop: int) -> PistonRecord:
    here = slice(start, stop)
    return PistonRecord(clock[here] - clock[start], height[here], force=force[here])


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    header, *rows = csv.reader(read_text(path, _MOST_BYTES).splitlines() or [""])
    names = [name.strip().lower() for name in header]
    columns = []
    for name in ("v1", "v2"):
        if name not in names:
            raise InputError(f"{sanitize(path)}: no column {name!r}; give the benchmark's file SNLS80mV.csv")
        position = names.index(name)
        try:
            columns.append(np.array([float(row[position]) for row in rows if row]))
        except (ValueError, IndexError):
            raise InputError(
                f"{sanitize(path)}: column {name!r} holds something that is not a number; give the "
                "benchmark's file SNLS80mV.csv as it is"
            ) from None
    force, height = columns
    if len(force) < ARROW + 2 * _TEST:
        raise InputError(
            f"{sanitize(path)}: {len(force)} samples; the benchmark's record has 131,072: give all"
        )
    return force, height


def silverbox_text(result: dict[str, Any]) -> str:
    """Return the errors of the free runs as a table."""
    parts = tuple(result["rows"][0]["errors"])
    rows = [
        (
            row["law"],
            *(f"{row['errors'][part]:.3f}" for part in parts),
            row["interpolation"],
            f"{row['seconds']:.0f}",
        )
        for row in result["rows"]
    ]
    header = ("law", *(f"{part} [mV]" for part in parts), "input between samples", "s")
    return str(Table(header, rows))
