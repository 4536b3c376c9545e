"""The Silverbox benchmark: an electronic Duffing oscillator under a force.

The record (T. Wigren, J. Schoukens 2013, doi:10.23919/ECC.2013.6669201; available from
https://www.nonlinearbenchmark.org) has 131,072 samples at 610.35 Hz. The first 40,400 samples are the
"arrow", the response to noise of increasing amplitude. Ten odd multisines follow. Laws are fitted to nine of
them. They are tested by free runs over the tenth multisine and over the arrow, with and without the part
whose amplitudes exceed the amplitudes of the fitted data. The data are not part of this package.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, sanitize
from granular.shared.files import read_text
from reduced_models import ReducedModel
from reduced_models.records.inputs import input_column
from research.benchmarks.benchmark import Benchmark, PublishedErrors, SignalCurve, rms_error

_FILE = "SNLS80mV.csv"
_SHOWN = slice(2000, 2600)
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


def _load_training_record_and_tests(folder: Path) -> tuple[PistonRecord, dict[str, PistonRecord]]:
    force, height = _read_force_and_height(folder / _FILE)
    clock = np.arange(len(force)) / SAMPLING
    first = next(k for k in range(ARROW, len(force)) if abs(force[k]) > 1e-2)
    training = _record_of_samples(clock, height, force, first, len(force) - _TEST)
    return training, {
        "multisine": _record_of_samples(clock, height, force, len(force) - _TEST, len(force)),
        "arrow": _record_of_samples(clock, height, force, 0, ARROW),
        "arrow, no extrapolation": _record_of_samples(clock, height, force, 0, _SMALL_ARROW),
    }


def _errors_and_curve_of_model(
    model: ReducedModel, tests: dict[str, PistonRecord]
) -> tuple[tuple[float, ...], SignalCurve]:
    errors, runs = [], {}
    for part, record in tests.items():
        inputs = {"force": input_column(record, "force")}
        start, speed = (float(record.height[0]), float(np.gradient(record.height, record.time)[0]))
        runs[part] = model.simulate(record.time, z0=start, v0=speed, inputs=inputs).height
        errors.append(1e3 * rms_error(runs[part][_WASHED_OUT:], record.height[_WASHED_OUT:]))
    record = tests["multisine"]
    return tuple(errors), SignalCurve(record.time[_SHOWN], record.height[_SHOWN], runs["multisine"][_SHOWN])


def _record_of_samples(
    clock: np.ndarray, height: np.ndarray, force: np.ndarray, start: int, stop: int
) -> PistonRecord:
    here = slice(start, stop)
    return PistonRecord(clock[here] - clock[start], height[here], force=force[here])


def _read_force_and_height(path: Path) -> tuple[np.ndarray, np.ndarray]:
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


SILVERBOX = Benchmark(
    name="Silverbox",
    split="fit to nine multisines; free runs over the tenth and over the arrow",
    measure="rms error of a free run [mV]",
    files=(_FILE,),
    get_it="https://www.nonlinearbenchmark.org, or github.com/biaslab/nsi-silverbox",
    laws=LAWS,
    tests=("multisine [mV]", "arrow [mV]", "arrow, no extrapolation [mV]"),
    published=(
        PublishedErrors("lowest of several", "grey box", ("0.26", None, None), "nonlinearbenchmark.org"),
        PublishedErrors("highest of several", "grey box", ("0.4", None, None), "nonlinearbenchmark.org"),
    ),
    read=_load_training_record_and_tests,
    judge=_errors_and_curve_of_model,
)
