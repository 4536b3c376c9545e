"""The Bouc-Wen benchmark: a simulated hysteretic oscillator under a force, with noise in the training data.

J. P. Noel, M. Schoukens 2016. The multisines for training and test are in the periodic steady state. A free
run therefore covers two periods, and its error is computed over the second. The test with a sweep starts at
rest.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, sanitize
from reduced_models import FitOptions, ReducedModel
from research.benchmarks.benchmark import Benchmark, PublishedErrors, SignalCurve, rms_error

TRAINING = 4096
"""Number of fitted samples, which are a tenth of the training signal, or half a period."""
_FILES = ("bw_train_multisine.npz", "bw_test_multisine.npz", "bw_test_sinesweep.npz")
_SHOWN = slice(2000, 2600)


class _TestSignals(NamedTuple):
    force: np.ndarray
    displacement: np.ndarray
    rate: float  # [Hz]


def _load_signals(path: Path) -> _TestSignals:
    with np.load(path, allow_pickle=False) as content:
        try:
            return _TestSignals(np.ravel(content["u"]), np.ravel(content["y"]), float(content["fs"]))
        except KeyError as error:
            raise InputError(
                f"{sanitize(path)}: no array {error}; give the benchmark's file as it is"
            ) from None


def _read_training_record_and_tests(folder: Path) -> tuple[PistonRecord, tuple[_TestSignals, _TestSignals]]:
    training, multisine, sweep = (_load_signals(folder / name) for name in _FILES)
    here = slice(0, TRAINING)
    clock = np.arange(TRAINING) / training.rate
    return PistonRecord(clock, training.displacement[here], force=training.force[here]), (multisine, sweep)


def _simulate_under_force(model: ReducedModel, force: np.ndarray, rate: float) -> np.ndarray:
    clock = np.arange(len(force)) / rate
    return model.simulate(clock, z0=0.0, v0=0.0, inputs={"force": force}).height


def _errors_and_curve_of_model(
    model: ReducedModel, tests: tuple[_TestSignals, _TestSignals]
) -> tuple[tuple[float, ...], SignalCurve]:
    multisine, sweep = tests
    count = len(multisine.force)
    steady = _simulate_under_force(model, np.tile(multisine.force, 2), multisine.rate)[count:]
    swept = _simulate_under_force(model, sweep.force, sweep.rate)
    errors = rms_error(steady, multisine.displacement), rms_error(swept, sweep.displacement)
    clock = np.arange(count)[_SHOWN] / multisine.rate
    return errors, SignalCurve(clock, multisine.displacement[_SHOWN], steady[_SHOWN])


BOUC_WEN = Benchmark(
    name="Bouc-Wen",
    split="fit to the first 4096 samples of the training multisine (a tenth); two official test signals",
    measure="rms error of a free run [m]",
    files=_FILES,
    get_it="https://www.nonlinearbenchmark.org, or github.com/forgi86/dynonet, examples/BW/data",
    laws={"Bouc-Wen": "m*z'' + c*z' + k*z + h = force; h' = a*z' - b*Abs(z')*h - d*z'*Abs(h)"},
    tests=("multisine [m]", "sweep [m]"),
    published=(
        PublishedErrors("the true law", "grey box", ("2.43e-07", "2.56e-06"), "simulated with its numbers"),
        PublishedErrors("PNLSS", "black box", ("1.87e-05", None), "A. F. Esfahani et al. 2017"),
        PublishedErrors("dynoNet", "black box", ("4.52e-05", None), "M. Forgione, D. Piga 2021"),
    ),
    read=_read_training_record_and_tests,
    judge=_errors_and_curve_of_model,
    options=FitOptions(initial="free"),
)
