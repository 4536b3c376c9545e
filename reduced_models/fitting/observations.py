"""Choose the columns of the records that a fit compares with a law's height or observations.

A velocity or acceleration signal does not fix the origin of the heights. If the law keeps its form when
heights are shifted, heights are therefore measured from equilibrium. A signal of unknown gain does not fix
the scale of the heights. If the law keeps its form when heights are rescaled, heights are therefore given in
units of the signal. Parameters that change under the shift or rescaling cannot be identified.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, RecordError, RecordWarning, quote
from reduced_models.fitting.fit_data import FitData, fit_data_of_record, weights_and_noise_of_records
from reduced_models.fitting.parameter import ParameterSettings
from reduced_models.fitting.residuals import LossName
from reduced_models.laws.law import Law
from reduced_models.laws.symmetry import find_compensating_parameters
from reduced_models.records.derivatives import noise_standard_deviation
from reduced_models.records.inputs import Interpolation, with_stroke_columns
from reduced_models.records.sensor import Sensor, sensor_of_column, sensor_unless_height
from reduced_models.records.sensor_artefacts import keep_samples_text, without_clipped_samples


class ObservedRecords(NamedTuple):
    """Records prepared for a fit, with the sensor that turns the law's motion into their signal."""

    records: Sequence[PistonRecord]
    sensor: Sensor | None = None
    held: tuple[str, ...] = ()  # parameters held at zero, so that heights are measured from equilibrium
    unidentified: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def prepare_observed_records(
    law: Law,
    records: Sequence[PistonRecord],
    measured: str | Sensor | None,
    declared: Collection[str],
    initial: Mapping[str, float],
) -> ObservedRecords:
    """Return records with the columns that a law needs, and the sensor that gives their signal."""
    given = measured or records[0].measured
    if law.prescribed:
        name = law.observations[0]
        cell = measured if isinstance(measured, Sensor) else None
        if len(law.observations) > 1:
            return ObservedRecords([with_stroke_columns(record) for record in records])
        # A force may be the reaction of the moved part, with the opposite sign; other columns are unchanged.
        plain = Sensor("force", gain=None if name == "force" else 1.0, offset=0.0, column=name)
        return _strokes_and_signed_load_cell(records, cell or plain)
    if law.observations:
        if measured is not None:
            raise InputError(
                f"the law {quote(law.name)} itself defines the compared columns "
                f"({', '.join(law.observations)}); remove the argument measured"
            )
        return ObservedRecords(records)
    sensor = None if given == "height" else sensor_unless_height(given)
    if sensor is None:
        return ObservedRecords(records)
    identified, held, unidentified = _identifiable_sensor(law, sensor, declared, initial)
    if sensor != identified:  # its gain is held
        records = [
            dataclasses.replace(
                record, deviations=sensor.deviations_with_open_gain(record.columns, record.deviations)
            )
            for record in records
        ]
    return ObservedRecords(records, identified, held, unidentified)


def _identifiable_sensor(
    law: Law, sensor: Sensor, declared: Collection[str], initial: Mapping[str, float]
) -> tuple[Sensor, tuple[str, ...], tuple[str, ...]]:
    """Return a sensor with an identifiable gain, parameters to hold at zero, and undetermined quantities."""
    held: tuple[str, ...] = ()
    unidentified: list[str] = []
    has_line = law.parsed_equation.line is not None
    shift = None if has_line else find_compensating_parameters(law, "shift")
    level_is_open = sensor.derivative_order > 0 or sensor.offset == "free"
    if shift is not None and level_is_open and "height" not in initial:
        identified = shift.level in declared
        if shift.level and not identified:
            held = (shift.level,)
        if not identified:
            unidentified += ["level", *(name for name in shift.moving if name == shift.level)]
    if sensor.gain == "free" or isinstance(sensor.gain, tuple):
        scale = None if has_line else find_compensating_parameters(law, "scale")
        if scale is not None and not {*scale.moving} & {*declared}:
            if sensor.gain == "free":
                unidentified += ["size", *(name for name in scale.moving if name not in unidentified)]
            sensor = dataclasses.replace(sensor, gain=sensor.nominal_gain)
    return sensor, held, tuple(unidentified)


def _strokes_and_signed_load_cell(records: Sequence[PistonRecord], cell: Sensor) -> ObservedRecords:
    """Return the records, and the load cell with the sign for which force loops dissipate energy."""
    if cell.filter_order or cell.absolute:
        raise InputError(
            "a load cell on a prescribed stroke cannot have a filter or a moving base; give gain and "
            "offset alone"
        )
    energy = 0.0
    for record in records:
        signal = cell.signal(record.columns)
        if not np.ptp(record.height) > 0.0:
            raise RecordError("the stroke of the record is constant; give a record whose stroke changes")
        if not np.ptp(signal) > 0.0:
            raise RecordError(
                f"the column {cell.column or cell.quantity} is constant; give a record in which it changes"
            )
        energy += float(np.trapezoid((signal - cell.nominal_offset) / cell.nominal_gain, record.height))
    sign_is_reversed = energy < 0.0 and not isinstance(cell.gain, int | float)
    note = (
        "the force-displacement loops release energy, so the measured force is the reaction on the driven "
        "part and its sign was reversed; Sensor('force', gain=1.0) keeps the sign"
    )
    gain = -cell.nominal_gain if sign_is_reversed else cell.nominal_gain
    sensor = dataclasses.replace(cell, gain=gain, offset=cell.nominal_offset)
    strokes = [dataclasses.replace(with_stroke_columns(record), complete=True) for record in records]
    return ObservedRecords(strokes, sensor, notes=(note,) * sign_is_reversed)


def fit_data_of_observed_columns(
    observed: ObservedRecords,
    settings: ParameterSettings,
    test_fraction: float,
    weights: Any,
    noise: Any,
    loss: LossName,
    interpolation: Interpolation,
    initial: Mapping[str, float],
) -> tuple[FitData, ...]:
    """Return the data of a fit, one item for each compared column of each record."""
    law = settings.law
    names = law.observations or ("",)
    if len(names) > 1 and (weights is not None or not isinstance(noise, Mapping | None)):
        raise InputError(
            f"several columns are observed; give noise as a mapping, {{{quote(names[0])}: ...}}, and "
            "remove weights"
        )
    if isinstance(noise, Mapping):
        _check_noise_names(law, noise)
    result = []
    shared = [_shared_sample_mask(record, law.observations) for record in observed.records]
    bounds = settings.bounds | dict.fromkeys(observed.held, (0.0, 0.0))
    for name in names:
        column_noise = noise.get(name) if isinstance(noise, Mapping) else noise
        given = weights_and_noise_of_records(observed.records, weights, column_noise)
        for number, record in enumerate(observed.records):
            weight, level = given[number]
            data = fit_data_of_record(
                law,
                record.select(shared[number]),
                test_fraction,
                None if weight is None else weight[shared[number]],
                level,
                loss,
                observed.sensor,
                name,
                interpolation,
                about_rest="level" in observed.unidentified or not law.observes_height,
            )
            fixed = {key: (value, value) for key, value in settings.by_record[number].items()}
            result.append(
                dataclasses.replace(
                    data,
                    number=number,
                    bounds=bounds | fixed,
                    initial=initial,
                    per_record=settings.per_record,
                )
            )
    return tuple(result) if len(names) == 1 else _weight_columns_by_noise(result)


def _shared_sample_mask(record: PistonRecord, names: Sequence[str]) -> np.ndarray:
    """Return a mask that excludes the initial samples in which a sensor clips a column."""
    start = record.time[0]
    if len(names) > 1:
        with warnings.catch_warnings(action="ignore"):
            for name in names:
                signal = sensor_of_column(name).signal(record.columns)
                sound = without_clipped_samples(dataclasses.replace(record, height=signal))
                start = max(start, sound.time[0])
    if start > record.time[0]:
        cause = "a column begins at the limit of its sensor (clipped)"
        cut = f"the first {start - record.time[0]:.3g} s are omitted"
        warnings.warn(f"{cause}, so {cut}; {keep_samples_text(record)}", RecordWarning, stacklevel=3)
    return np.asarray(record.time >= start)


def _check_noise_names(law: Law, noise: Mapping[str, Any]) -> None:
    """Check that noise given by name has exactly the names of the observed columns of a law."""
    if not law.observations:
        raise InputError(
            f"noise: the law {quote(law.name)} defines no observed column; give a number instead of a mapping"
        )
    unknown = [str(name) for name in noise if name not in law.observations]
    missing = [name for name in law.observations if name not in noise]
    if unknown or missing:
        wrong = [f"no column {', '.join(map(quote, unknown))} is observed"] if unknown else []
        wrong += [f"{', '.join(map(quote, missing))} is missing"] if missing else []
        raise InputError(f"noise: {', and '.join(wrong)}; give the noise of {', '.join(law.observations)}")


def _weight_columns_by_noise(data: Sequence[FitData]) -> tuple[FitData, ...]:
    """Weight columns of different quantities by the ratio of their signal to their noise."""
    levels = []
    for item in data:
        level = item.noise or noise_standard_deviation(item.record.height, item.record.time)
        levels.append(level / item.unknowns.signal)
    minimum = max(min(levels), 1e-300)
    balances = [minimum / max(level, minimum) for level in levels]
    return tuple(
        dataclasses.replace(item, weights=item.weights * balance, balance=balance)
        for item, balance in zip(data, balances, strict=True)
    )
