"""A record as what equations are weighed against: its motion, derivatives and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.discovery.weak_form import SmoothedMotion
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod, derivatives
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.inputs import column

_FLOOR = 1e-6  # least noise, in standard deviations of the record: rounding and quadrature


def motion_of(
    record: PistonRecord,
    height_map: HeightMap,
    derivative: DerivativeMethod,
    drive: str | None = None,
) -> SmoothedMotion:
    """The motion of a record in z, with estimates of its derivatives and noise."""
    guess = first_guesses(record)
    smooth = derivatives(record, derivative)
    size = abs(height_map.scale)
    swing = float(record.height.std())
    return SmoothedMotion(
        time=record.time - record.time[0],
        z=np.asarray(height_map.to_law(record.height)),
        smooth=np.asarray(height_map.to_law(smooth.height)),
        velocity=smooth.velocity / height_map.scale,
        acceleration=smooth.acceleration / height_map.scale,
        drive=None if drive is None else column(record, drive),
        noise=max(smooth.record_noise, _FLOOR * swing) / size,
        acceleration_noise=max(smooth.noise.acceleration, _FLOOR * swing) / size,
        period=guess.period,
    )


def map_of(records: Sequence[PistonRecord], wanted: HeightMap | str) -> HeightMap:
    """The map that is wanted; "auto" is the height, or the swing about rest in amplitudes."""
    if isinstance(wanted, HeightMap):
        return wanted
    if wanted != "auto":
        raise InputError(f"map = {quoted(wanted)}; give 'auto' or a HeightMap")
    guess = max((first_guesses(each) for each in records), key=lambda one: one.amplitude)
    # Powers of a height that hardly changes could not be told apart.
    if abs(guess.rest) <= guess.amplitude:
        return HeightMap()
    return HeightMap(guess.rest, guess.amplitude)
