"""Limits of a sensor's signal: the level, size and parameters of a law that it does not tell.

A signal of velocities or accelerations says nothing of where heights count from, and one of
unknown gain nothing of their unit. Where a law keeps its form under such a change, the coordinate
is chosen: heights count from the level of rest, and in units of the signal. Parameters that the
change moves mean nothing then.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from typing import NamedTuple

from reduced_models.laws.law import Law
from reduced_models.laws.symmetry import find_similarity
from reduced_models.records.sensor import Sensor


class IdentifiableSensor(NamedTuple):
    """A sensor as a fit of a law takes it."""

    sensor: Sensor | None
    held: tuple[str, ...] = ()  # at zero, so that heights count from rest
    untold: tuple[str, ...] = ()


def identifiable_sensor(
    law: Law, sensor: Sensor, declared: Collection[str], initial: Mapping[str, float]
) -> IdentifiableSensor:
    """Sensor as a fit of a law can take it, and what of the law its signal leaves open."""
    held: tuple[str, ...] = ()
    untold: list[str] = []
    has_line = law.parsed_equation.line is not None
    shift = None if has_line else find_similarity(law, "shift")
    level_is_open = sensor.derivative_order > 0 or sensor.offset == "free"
    if shift is not None and level_is_open and "height" not in initial:
        known = shift.level in declared
        if shift.level and not known:
            held = (shift.level,)
        if not known:
            untold += ["level", *(name for name in shift.moving if name == shift.level)]
    if sensor.gain == "free" or isinstance(sensor.gain, tuple):
        scale = None if has_line else find_similarity(law, "scale")
        if scale is not None and not {*scale.moving} & {*declared}:
            if sensor.gain == "free":
                untold += ["size", *(name for name in scale.moving if name not in untold)]
            sensor = dataclasses.replace(sensor, gain=sensor.nominal_gain)
    return IdentifiableSensor(sensor, held, tuple(untold))
