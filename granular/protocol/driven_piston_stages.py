"""Stages in which the piston stands still or is driven along a path."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from granular.formulas.dimensions import LENGTH, TIME, Dimension
from granular.protocol.piston_motion import DESCENT, SINE, TABLE, Motion
from granular.protocol.stage import FormulaStage, Stage, TimedStage
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, quantity_list_field, text_field


class Hold(TimedStage):
    """The piston stays where it is. Without duration and ``until``: as long as the run."""

    needs_piston = False  # a bed without a piston can be held, too

    def motion(self, height: float, scales: Scales) -> Motion:
        """Piston at rest at its present height; height [m]."""
        return Motion(start=height / scales.length)


class Move(Stage):
    """Constant speed to a height, as in the compression of [D, 2.3.3].

    Attributes
    ----------
    to : float
        Height at the end [m].
    speed : float or None
        Magnitude of the velocity [m/s].
    duration : float or None
        Duration [s]; one of speed and duration is given.
    until_force : float or None
        Stop before, as soon as the grains push the piston with this force [N]; the experiments of
        de Paula stop at 110 N.
    """

    to: float = quantity("m", above=0.0)
    speed: float | None = quantity("m/s", above=0.0, default=None, optional=True)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until_force: float | None = quantity("N", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that one of speed and duration is given."""
        if (self.speed is None) == (self.duration is None):
            raise FieldError("give either speed or duration", "speed")

    @property
    def ends_at_force(self) -> bool:
        """True where ``until_force`` is given."""
        return self.until_force is not None

    def total_duration(self, height: float) -> float | None:
        """Duration of the way at the constant speed [s]; height [m]."""
        if self.duration is not None:
            return self.duration
        assert self.speed is not None
        return abs(self.to - height) / self.speed

    def motion(self, height: float, scales: Scales) -> Motion:
        """Straight motion to ``to``; height [m]."""
        duration = self.total_duration(height)
        velocity = (self.to - height) / duration if duration else 0.0
        limit = math.inf if self.until_force is None else self.until_force / scales.force
        return Motion(start=height / scales.length, speed=velocity / scales.velocity, limit=limit)

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.to


class Descend(Stage):
    """Descent by the exponential law of [D, 2.3.2].

    It is read as

        H(t) = H_s - (H_s - to) (e^(k t/duration) - 1) / (e^k - 1)

    from the present height H_s, with k = 5: de Paula's relaxation of 5 T under exp(t/T - 5).

    Attributes
    ----------
    to : float
        Height at the end [m].
    duration : float
        [s]
    steepness : float
        k
    """

    to: float = quantity("m", above=0.0)
    duration: float = quantity("s", above=0.0)
    steepness: float = quantity("1", default=5.0, above=0.0)

    def motion(self, height: float, scales: Scales) -> Motion:
        """Exponential descent to ``to``, [D, 2.3.2]; height [m]."""
        return Motion(
            kind=DESCENT,
            start=height / scales.length,
            reach=(height - self.to) / scales.length,
            total_duration=self.duration / scales.time,
            steepness=self.steepness,
        )

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.to


class Follow(Stage):
    """Straight lines from row to row of a table; the piston starts at the first height.

    Attributes
    ----------
    times : tuple of float
        [s], increasing from 0, counted from the stage's start.
    heights : tuple of float
        [m]
    """

    times: tuple[float, ...] = quantity_list_field("s", least=0.0)
    heights: tuple[float, ...] = quantity_list_field("m", above=0.0)

    def validate(self) -> None:
        """Check that the times increase from 0, with a height each."""
        if len(self.times) != len(self.heights):
            raise FieldError(f"holds {len(self.heights)} values for {len(self.times)} times", "heights")
        if len(self.times) < 2 or self.times[0] != 0.0 or (np.diff(self.times) <= 0.0).any():
            raise FieldError("must increase from 0, with at least two values", "times")

    def total_duration(self, height: float) -> float | None:
        """Duration of the table [s]; height [m]."""
        return self.times[-1]

    def motion(self, height: float, scales: Scales) -> Motion:
        """Straight lines from row to row of the table; height [m]."""
        return Motion(
            kind=TABLE,
            start=self.heights[0] / scales.length,
            times=np.array(self.times) / scales.time,
            heights=np.array(self.heights) / scales.length,
        )

    def initial_jump(self, height: float) -> float:
        """Jump of the piston to the first height of the table [m]; height [m]."""
        return self.heights[0] - height

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.heights[-1]


class Oscillate(Stage):
    """Height H + amplitude sin(2 pi f t) about the present height H.

    Attributes
    ----------
    amplitude : float
        [m]
    frequency : float
        f [Hz]; t counts from the stage's start.
    duration : float or None
        [s]; without, as long as the run.
    """

    amplitude: float = quantity("m", above=0.0)
    frequency: float = quantity("Hz", above=0.0)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that the duration is at least a quarter of a period."""
        if self.duration is not None and self.duration * self.frequency < 0.25:
            raise FieldError(
                f"{self.duration:g} s is less than a quarter of a period, {0.25 / self.frequency:g} s",
                "duration",
            )

    def motion(self, height: float, scales: Scales) -> Motion:
        """Sine about the present height; height [m]."""
        return Motion(
            kind=SINE,
            start=height / scales.length,
            reach=self.amplitude / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
        )


class Lift(Stage):
    """The nudge of [D, 5.3]: the piston is set ``by`` higher, faster than the grains can follow.

    Attributes
    ----------
    by : float
        Displacement [m]; negative lowers the piston.
    """

    by: float = quantity("m")

    def initial_jump(self, height: float) -> float:
        """Jump of the piston [m]; height [m]."""
        return self.by

    def total_duration(self, height: float) -> float | None:
        """Duration of the jump; height [m]."""
        return 0.0

    def motion(self, height: float, scales: Scales) -> Motion:
        """Piston at rest at the height that it jumped to; height [m]."""
        return Motion(start=height / scales.length)


class Path(FormulaStage):
    """A height as a formula, such as ``h0 - a*(1 - cos(w*t))/2``.

    Attributes
    ----------
    height : str
        [m]; of the time ``t`` since the stage's start, the height ``h0`` there, and parameters,
        which stand next to it with their units. It must begin at ``h0`` and be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME, "h0": LENGTH}
    formula_key: ClassVar[str] = "height"
    unit: ClassVar[str] = "m"

    height: str = text_field()
