"""The Bouc-Wen benchmark: a simulated hysteretic oscillator under a force, with noise in the training data.

J. P. Noel, M. Schoukens 2016. Training and test multisines are steady, so a free run over two periods is
judged on the second; the sweep starts at rest.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, sanitize
from reduced_models import FitOptions, ReducedModel
from research.benchmarks.benchmark import Benchmark, Curve, Published, rms_error

TRAINING = 4096
"""Samples of the training signal that are fitted: a tenth of it, half a period."""
_FILES = ("bw_train_multisine.npz", "bw_test_multisine.npz", "bw_test_sinesweep.npz")
_SHOWN = slice(2000, 2600)


class _Test(NamedTuple):
    force: np.ndarray
    displacement: np.ndarray
    rate: float  # [Hz]


def _load(path: Path) -> _Test:
    with np.load(path, allow_pickle=False) as content:
        try:
            return _Test(np.ravel(content["u"]), np.ravel(content["y"]), float(content["fs"]))
        except KeyError as error:
            raise InputError(
                f"{sanitize(path)}: no array {error}; give the benchmark's file as it is"
            ) from None


def _read(folder: Path) -> tuple[PistonRecord, tuple[_Test, _Test]]:
    training, multisine, sweep = (_load(folder / name) for name in _FILES)
    here = slice(0, TRAINING)
    clock = np.arange(TRAINING) / training.rate
    return PistonRecord(clock, training.displacement[here], force=training.force[here]), (multisine, sweep)


def _free_run(model: ReducedModel, force: np.ndarray, rate: float) -> np.ndarray:
    clock = np.arange(len(force)) / rate
    return model.simulate(clock, z0=0.0, v0=0.0, inputs={"force": force}).height


def _judge(model: ReducedModel, tests: tuple[_Test, _Test]) -> tuple[tuple[float, ...], Curve]:
    multisine, sweep = tests
    count = len(multisine.force)
    steady = _free_run(model, np.tile(multisine.force, 2), multisine.rate)[count:]
    swept = _free_run(model, sweep.force, sweep.rate)
    errors = rms_error(steady, multisine.displacement), rms_error(swept, sweep.displacement)
    clock = np.arange(count)[_SHOWN] / multisine.rate
    return errors, Curve(clock, multisine.displacement[_SHOWN], steady[_SHOWN])


BOUC_WEN = Benchmark(
    name="Bouc-Wen",
    split="fit to the first 4096 samples of the training multisine (a tenth); two official test signals",
    measure="rms error of a free run [m]",
    files=_FILES,
    get_it="https://www.nonlinearbenchmark.org, or github.com/forgi86/dynonet, examples/BW/data",
    laws={"Bouc-Wen": "m*z'' + c*z' + k*z + h = force; h' = a*z' - b*Abs(z')*h - d*z'*Abs(h)"},
    tests=("multisine [m]", "sweep [m]"),
    published=(
        Published("the true law", "grey box", ("2.43e-07", "2.56e-06"), "simulated with its numbers"),
        Published("PNLSS", "black box", ("1.87e-05", None), "A. F. Esfahani et al. 2017"),
        Published("dynoNet", "black box", ("4.52e-05", None), "M. Forgione, D. Piga 2021"),
    ),
    read=_read,
    judge=_judge,
    options=FitOptions(initial="free"),
)
