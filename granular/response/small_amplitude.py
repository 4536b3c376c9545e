"""The response of a machine to a drive so small that its bed is linear, by the bed's matrices."""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.linear.equilibrium import Equilibrium, equilibrium
from granular.linear.response import harmonic_answers
from granular.linear.roots import require_free_piston
from granular.response.response import FrequencyResponse
from granular.shared.array_types import Complex, Float
from granular.shared.errors import GranularError, one_line


def add_linear_response(response: FrequencyResponse) -> FrequencyResponse:
    """Add the field ``linear``, the displacements by small motions [m], or say in ``no_linear`` why not."""
    data = response.dataset
    quantity, frequencies = response.quantity, data.frequency.values
    try:
        single = np.abs(linear_displacements(equilibrium(response.scene), quantity, frequencies))
    except GranularError as error:
        return dataclasses.replace(response, dataset=data.assign_attrs(no_linear=one_line(str(error))))
    attributes = {"units": "m", "long_name": "amplitude of the last body with the bed's small motions"}
    field = (data.displacement.dims, data.amplitude.values[:, None] * single, attributes)
    return dataclasses.replace(response, dataset=data.assign(linear=field))


def linear_displacements(
    rest: Equilibrium, quantity: str, frequencies: Float[np.ndarray, "f"]
) -> Complex[np.ndarray, "f"]:
    """Displacement of the last body, or of a load on the piston, over the drive [m/N, s^2 or 1]."""
    bed = rest.pencil.bed
    piston, host = require_free_piston(rest), rest.scene.effects.host
    assert host is not None
    push = np.zeros(bed.size)
    if quantity == "force":
        push[bed.bodies + (len(host.bodies) - 1 if host.excited is None else host.excited)] = 1.0
    else:
        push = -(rest.pencil.mass @ bed.frame_and_uplift()[1])
    answer = bed.size - 1 if host.bodies else piston
    return harmonic_answers(rest, frequencies, push, 2 if quantity == "displacement" else 0)[:, answer]
