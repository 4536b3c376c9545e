"""Simulate a scene with trial parameters, and compute the features that are compared with a record.

After a few cycles the oscillations of two beds differ in phase, so heights at the same instant cannot be
compared. Equilibrium height, period and damping ratio do not depend on the phase; they are taken from the
same law, fitted to both motions. Matching them is called indirect inference (Gourieroux, Monfort, Renault
1993, doi:10.1002/jae.3950080507).
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.scene.scene import Scene
from granular.schema.field_kinds import QuantityKind
from granular.schema.sections import find_field_value_and_kind
from granular.shared.array_types import Float
from granular.shared.errors import InputError, RecordError
from granular.studies.cases import CaseOutcome, piston_columns
from granular.studies.sweep import sweep
from reduced_models.fitting.fit import fit
from reduced_models.laws.law import Law
from reduced_models.records.derivatives import noise_standard_deviation

DEFAULT_LAW = "polynomial-spring"
FIT_STARTS = 8
_MAXIMUM_RESIDUAL = 0.5
_ONE_SIGMA = math.erf(math.sqrt(0.5))


class FeaturesOfRecord(NamedTuple):
    """Quantities above 0, computed from a record, that the simulations are to reproduce."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "d"]  # [m, s, 1, N]
    errors: Float[np.ndarray, "d"]  # standard errors of their logarithms
    notes: tuple[str, ...]


def measure_record_features(
    record: PistonRecord, law: str | Law = DEFAULT_LAW, *, force: bool = False
) -> FeaturesOfRecord:
    """Compute features of a record: equilibrium height, period, damping ratio and, on request, mean force."""
    with warnings.catch_warnings(action="ignore"):
        model = fit(record, law, test_fraction=0.0, starts=FIT_STARTS, confidence=_ONE_SIGMA)
    if model.quality.relative > _MAXIMUM_RESIDUAL:
        raise RecordError(
            f"the law {model.law.name!r} leaves {100.0 * model.quality.relative:.3g} % of the "
            f"record's rms displacement unexplained, but the maximum is {100.0 * _MAXIMUM_RESIDUAL:g} %; "
            "give a record that oscillates about equilibrium and settles, or another law"
        )
    if model.at_rest is None:
        raise RecordError(
            f"the fitted law {model.law.name!r} has no equilibrium near the record; give a record that "
            "oscillates about equilibrium, or another law"
        )
    names = list(model.at_rest.intervals)
    values = [getattr(model.at_rest, name) for name in names]
    errors = [0.5 * (high - low) for low, high in model.at_rest.intervals.values()]
    if force:
        if record.force is None:
            raise RecordError(
                "the record has no column 'force', which is needed for the mean force; add the column"
            )
        names.append("force")
        level, error = _mean_force_and_standard_error(record.time, record.force)
        values.append(level)
        errors.append(error)
    for name, value in zip(names, values, strict=True):
        if not value > 0.0:
            raise RecordError(
                f"the record's {name.replace('_', ' ')} is {value:.3g}, but it must be above 0; give a "
                "record that comes to rest"
            )
    relative = np.array(errors) / np.array(values)
    return FeaturesOfRecord(tuple(names), np.array(values), relative, model.notes)


def _mean_force_and_standard_error(time: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Return the mean force and its standard error; a window suppresses incomplete cycles."""
    phase = (time - time[0]) / (time[-1] - time[0])
    weight = np.sin(math.pi * phase) ** 2 * np.gradient(time)
    weight /= weight.sum()
    return float(weight @ force), noise_standard_deviation(force, time) * float(np.sqrt((weight**2).sum()))


_DIGITS = 12  # digits of a parameter: positions that differ only by rounding share a simulation


class SceneParameter(NamedTuple):
    """A quantity of a scene that is calibrated."""

    key: str  # dotted key of the scene
    value: float  # in SI, above 0
    unit: str


def positive_scene_parameter(scene: Scene, key: str) -> SceneParameter:
    """Return a quantity of a scene; it must be positive, since the search uses its logarithm."""
    field = find_field_value_and_kind(scene, key)
    if field is None:
        scene.replace(**{key: 1.0})  # its error suggests a similar key
        raise InputError(f"the scene has no {key}; set it, or calibrate a quantity that the scene has")
    value, kind = field
    if not isinstance(kind, QuantityKind):
        raise InputError(f"{key} is not a quantity; calibrate a quantity such as piston.mass")
    if value is None or not value > 0.0:
        raise InputError(
            f"{key} = {'none' if value is None else value} cannot be calibrated, since a start "
            "value above 0 is needed; set one in the scene"
        )
    return SceneParameter(key, float(value), "" if kind.unit == "1" else kind.unit)


class SimulatedPoint(NamedTuple):
    """Simulations with the same parameters and different random packings."""

    position: Float[np.ndarray, "p"]  # logarithms of the parameters
    records: tuple[PistonRecord, ...]
    logs: Float[np.ndarray, "starts d"]  # logarithms of their features
    failure: str = ""  # reason for missing records; empty otherwise

    @property
    def mean(self) -> np.ndarray:
        """Mean (d,) over the random packings."""
        return np.asarray(self.logs.mean(axis=0))


@dataclasses.dataclass(frozen=True)
class SceneSimulator:
    """Simulator of a scene with trial parameters, and the settings of the comparison."""

    scene: Scene
    parameters: tuple[SceneParameter, ...]
    seeds: tuple[int, ...]
    law: str | Law
    duration: float  # [s]
    force: bool
    settings: Mapping[str, Any]

    def scene_changes(self, position: Float[np.ndarray, "p"]) -> dict[str, float]:
        """Return the changes of the scene at a position of the search, as values by dotted key."""
        return {
            parameter.key: float(f"{math.exp(log):.{_DIGITS}g}")
            for parameter, log in zip(self.parameters, position, strict=True)
        }

    def simulate_points(self, positions: Sequence[Float[np.ndarray, "p"]]) -> list[SimulatedPoint]:
        """Simulate all packings of the scene in parallel; a position has the logarithms of the parameters."""
        cases = [
            self.scene_changes(position) | {"arrangement.seed": seed}
            for position in positions
            for seed in self.seeds
        ]
        study = sweep(self.scene, cases=cases, measure=piston_columns, **self.settings)
        count = len(self.seeds)
        return [
            self._simulated_point(position, study.outcomes[k * count : (k + 1) * count])
            for k, position in enumerate(positions)
        ]

    def _simulated_point(self, position: np.ndarray, outcomes: Sequence[CaseOutcome]) -> SimulatedPoint:
        records, rows = [], []
        for seed, outcome in zip(self.seeds, outcomes, strict=True):
            try:
                if outcome.error is not None:
                    raise InputError(outcome.error)
                record = PistonRecord.from_columns(outcome.figures).with_time_from_zero()
                record = record.between(0.0, self.duration * (1.0 + 1e-9))
                figures = measure_record_features(record, self.law, force=self.force)
            except InputError as error:
                changed_values = ", ".join(
                    f"{key} = {value:.5g}" for key, value in self.scene_changes(position).items()
                )
                cause = f"the simulation with {changed_values} and seed {seed} failed: {error}"
                return SimulatedPoint(position, (), np.empty((0, 0)), cause)
            records.append(record)
            rows.append(np.log(figures.values))
        return SimulatedPoint(position, tuple(records), np.array(rows))
