"""Definition of a benchmark: its files, laws to fit, published errors, and the computation of our errors."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import CautionWarning
from reduced_models import ReducedModel, fit
from reduced_models.fitting.problem import FitOptions


class PublishedErrors(NamedTuple):
    """Published errors of a method, with None for a test without a published error."""

    method: str
    kind: str
    errors: tuple[str | None, ...]
    source: str


class SignalCurve(NamedTuple):
    """Measured and simulated signal of a test; time [s]."""

    time: Float[np.ndarray, "n"]
    measured: Float[np.ndarray, "n"]
    simulated: Float[np.ndarray, "n"]


class LawFitOutcome(NamedTuple):
    """Fit of a law, and its errors in the benchmark's tests."""

    name: str
    law: str
    parameters: dict[str, float]
    errors: tuple[float, ...]
    agreeing: str
    seconds: float  # of processor
    curve: SignalCurve


@dataclasses.dataclass(frozen=True, eq=False)
class Benchmark:
    """A public benchmark.

    Attributes
    ----------
    name, split, measure : str
    files : tuple of str
    get_it : str
        Place to get the files from.
    laws : mapping of str to str
        Equations by names.
    tests : tuple of str
        Names of the errors, with their unit.
    published : sequence of Published
    options : FitOptions
    read : callable
        Training record, and data for ``judge``, of a folder.
    judge : callable
        Errors and one curve of a fitted model.
    """

    name: str
    split: str
    measure: str
    files: tuple[str, ...]
    get_it: str
    laws: Mapping[str, str]
    tests: tuple[str, ...]
    published: Sequence[PublishedErrors]
    read: Callable[[Path], tuple[PistonRecord, Any]]
    judge: Callable[[ReducedModel, Any], tuple[tuple[float, ...], SignalCurve]]
    options: FitOptions | None = None

    def missing_files(self, folder: Path) -> tuple[str, ...]:
        """Files that are not in a folder."""
        return tuple(name for name in self.files if not (folder / name).is_file())

    def fit_laws_and_measure_errors(self, folder: Path) -> list[LawFitOutcome]:
        """Fit all laws with default settings, and measure the errors."""
        training, data = self.read(folder)
        outcomes = []
        for name, law in self.laws.items():
            begun = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", CautionWarning)
                model = fit(training, law, options=self.options)
            seconds = time.process_time() - begun
            errors, curve = self.judge(model, data)
            agreeing = f"{model.quality.converged} of {model.quality.starts}"
            outcomes.append(
                LawFitOutcome(name, law, dict(model.parameters), errors, agreeing, seconds, curve)
            )
        return outcomes


def rms_error(simulated: Float[np.ndarray, "n"], measured: Float[np.ndarray, "n"]) -> float:
    """Root mean square of the difference."""
    return float(np.sqrt(((simulated - measured) ** 2).mean()))
