"""Stages in which the piston is free, with or without a force from outside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from granular.formulas.dimensions import TIME, Dimension
from granular.protocol.piston_motion import Motion
from granular.protocol.stage import FormulaStage, TimedStage
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, text_field

if TYPE_CHECKING:
    from jaxtyping import Float


class Free(TimedStage):
    """Free motion from the present height and velocity. Needs ``piston.mass``."""

    needs_piston_mass = True

    def motion(self, height: float, scales: Scales) -> Motion:
        """Free motion from the present height and velocity; height [m]."""
        return Motion(free=True, start=height / scales.length)


class Push(TimedStage):
    """The force F(t) = mean + amplitude sin(2 pi f t) on the free piston, upwards.

    Attributes
    ----------
    amplitude, mean : float
        [N]
    frequency : float
        f [Hz]; t counts from the stage's start.
    """

    needs_piston_mass = True
    has_outer_force = True

    amplitude: float = quantity("N", default=0.0, least=0.0)
    mean: float = quantity("N", default=0.0)
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    def validate(self) -> None:
        """Check that a force with an amplitude has a frequency, and does not wait for rest."""
        super().validate()
        if self.amplitude > 0.0 and self.frequency == 0.0:
            raise FieldError("must be above 0 Hz where the force has an amplitude", "frequency")
        if self.until == "rest" and self.amplitude > 0.0:
            raise FieldError("a piston that is pushed to and fro does not come to rest", "until")

    def outer_force(self, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Sinusoidal force [N] at times since the stage's start [s]."""
        return self.mean + self.amplitude * np.sin(2.0 * math.pi * self.frequency * times)

    def motion(self, height: float, scales: Scales) -> Motion:
        """Free motion under a sinusoidal force; height [m]."""
        return Motion(
            free=True,
            start=height / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
            push=self.amplitude / scales.force,
            bias=self.mean / scales.force,
        )


class Force(FormulaStage):
    """A force on the free piston, upwards, such as ``f*exp(-t/s)``.

    Attributes
    ----------
    force : str
        [N]; of the time ``t`` since the stage's start, and parameters, which stand next to it with
        their units. It must be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME}
    needs_piston_mass = True
    has_outer_force = True
    driven_quantity = "force"
    formula_key: ClassVar[str] = "force"
    unit: ClassVar[str] = "N"

    force: str = text_field()
