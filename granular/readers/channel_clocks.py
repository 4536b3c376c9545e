"""Channels that start at other times, or are sampled at other rates, on the times of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.readers.column_headers import ACCELERATION, HEIGHT, TIME, VELOCITY, guess_column_role
from granular.readers.read_options import ANGLE, STROKE, ReadOptions
from granular.readers.sheet import Column
from granular.shared.message_text import quote

if TYPE_CHECKING:
    from jaxtyping import Float

_MOTION = (HEIGHT, ANGLE, STROKE, VELOCITY, ACCELERATION)
_SAME = 1e-3
"""Fraction of a step of the clock up to which two times are the same."""
_LEAST_SAMPLES = 2


class SampledChannel(NamedTuple):
    """Channel of an instrument, with values, and the times of its samples [s]."""

    column: Column
    times: Float[np.ndarray, "n"]


def columns_on_one_clock(
    channels: Sequence[SampledChannel], options: ReadOptions, notes: list[str]
) -> list[Column]:
    """Return the times of the motion's channel, those that all with a role share, with all channels."""
    motion = _motion_channel(channels, options)
    times = motion.times
    slack = _SAME * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    common = np.isfinite(times)
    for column, own in channels:
        if own is times or (
            len(own) == len(times) and np.allclose(own, times, rtol=0.0, atol=slack, equal_nan=True)
        ):
            continue
        assert column.values is not None
        known = np.isfinite(own) & np.isfinite(column.values)
        values = np.full(len(times), np.nan)
        if known.any():
            inside = (times >= own[known][0] - slack) & (times <= own[known][-1] + slack)
            values[inside] = np.interp(times[inside], own[known], column.values[known])
        column.values = values
        notes.append(_note_on_clock(column.name, motion.column.name, float(own[0] - times[0]), slack))
        together = common & np.isfinite(values)
        if _has_role(column, options) and together.sum() >= _LEAST_SAMPLES:
            if together.sum() < common.sum():
                notes[-1] += "; the record is cut to those of both"
            common = together
    if not common.all():
        times = times[common]
        for column, _ in channels:
            assert column.values is not None
            column.values = column.values[common]
    return [Column(TIME, "s", times), *(column for column, _ in channels)]


class SampledTimes:
    """Times of evenly sampled channels, one array for all that share a clock."""

    def __init__(self) -> None:
        self._made: dict[tuple[float, float, int], Float[np.ndarray, "n"]] = {}

    def at(self, first: float, step: float, count: int) -> Float[np.ndarray, "n"]:
        """Return the times of so many samples from a first one on, a step apart [s]."""
        key = (first, step, count)
        if key not in self._made:
            self._made[key] = first + step * np.arange(count)
        return self._made[key]


def _motion_channel(channels: Sequence[SampledChannel], options: ReadOptions) -> SampledChannel:
    """Channel that the options, or else its name, calls the coordinate; or else the first."""
    for role in _MOTION:
        said = options.columns.get(role)
        for number, channel in enumerate(channels, start=2):  # the times are column 1
            if said is not None and (channel.column.is_called(str(said)) or str(said) == str(number)):
                return channel
    named = (channel for channel in channels if guess_column_role(channel.column.name) == HEIGHT)
    return next(named, channels[0])


def _has_role(column: Column, options: ReadOptions) -> bool:
    return guess_column_role(column.name) is not None or any(
        column.is_called(str(said)) for said in options.columns.values()
    )


def _note_on_clock(name: str, other: str, delay: float, slack: float) -> str:
    when = f"starts {abs(delay):.4g} s {'after' if delay > 0.0 else 'before'} {quote(other)}"
    what = when if abs(delay) > slack else f"is sampled at other times than {quote(other)}"
    return f"{quote(name)} {what}, and is read at the times of the latter"
