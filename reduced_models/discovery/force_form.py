"""Equations weighed by what they leave of the force, and not by the noise of heights.

Of a piston whose motion is prescribed z'' tells nothing, and a force that was measured tells all.
Its integrals against bumps take the place of those of z''; the noise is that of the force.

Where no equation comes near to a record's noise, as of a simulated bed, which has none, the noise
says nothing of how errors are to be weighed either: that of heights would count the quickest ones
most. What is left is then taken as white noise of z''.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import Integrals, SmoothedMotion, WeakForm, weak_form
from reduced_models.records.first_guesses import noise_level

_FLOOR = 1e-6  # least noise, in standard deviations of the force


@dataclasses.dataclass(frozen=True, eq=False)
class ForceIntegrals(Integrals):
    """Integrals with errors that are white noise of the force; `Integrals` tells of attributes.

    Attributes
    ----------
    deviation : float
        Of that noise, in the target's unit.
    """

    deviation: float

    def noise_weights(self, terms: Sequence[AnyTerm], coefficients: np.ndarray) -> Any:
        """Of the force's noise alone, in units of the motion's."""
        return self.bump * (self.deviation / self.motion.noise)


def force_form(records: Sequence[PistonRecord], motions: Sequence[SmoothedMotion]) -> WeakForm:
    """The weak form of the measured forces [N] of some motions.

    Raises
    ------
    RecordError
        If a record has no force.
    """
    parts = []
    for record, one in zip(records, weak_form(*motions).parts, strict=True):
        force = record.force
        if force is None:
            raise RecordError(
                "target = 'force' needs a measured force, which the record does not have; give "
                "one with a column force"
            )
        noise = max(noise_level(force, record.time), _FLOOR * float(force.std()))
        motion = one.motion._replace(acceleration=force, acceleration_noise=noise)
        parts.append(
            ForceIntegrals(
                motion, one.bump, one.slope, one.curvature, np.asarray(one.bump @ force), noise
            )
        )
    return WeakForm(tuple(parts))


def without_noise(weak: WeakForm) -> WeakForm:
    """A weak form of z'' whose errors are white noise of z'', as large as in its estimate."""
    return WeakForm(
        tuple(
            ForceIntegrals(
                one.motion, one.bump, one.slope, one.curvature, one.target,
                one.motion.acceleration_noise,
            )
            for one in weak.parts
        )
    )  # fmt: skip
