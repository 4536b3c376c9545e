"""What an input does between samples, chosen by the error on what a fit has not seen."""

from __future__ import annotations

import dataclasses

import numpy as np

from reduced_models.fitting.candidate import Candidate, fine_grids
from reduced_models.fitting.case import Case
from reduced_models.fitting.refinement import JointRecords
from reduced_models.least_squares.residuals import BLOWN_UP
from reduced_models.records.inputs import INTERPOLATIONS

_MOST = 2000  # samples from which it is chosen
_CLEARLY = 0.98  # of the spline's error, for another to be taken


def interpolated(found: Candidate, case: Case) -> Candidate:
    """A fit with the interpolation of the inputs that has the least held-out error.

    Each is fitted to the training stretches, from the fit with splines, and judged behind them.
    """
    counts = [min(samples, _MOST) for samples in case.samples]
    # One step a sample at least: what a held input does within a step has no order.
    aligned = fine_grids(found.joint.unknowns.law, case._replace(interpolation="linear"))
    errors = {}
    for how in INTERPOLATIONS:
        grids = tuple(
            grid.on(steps, how) for grid, steps in zip(found.joint.grids, aligned, strict=True)
        )
        joint = dataclasses.replace(found.joint, grids=grids)
        theta = joint.sharpened(found.theta, counts, tolerance=1e-6)
        errors[how] = (_held_out(joint, theta, counts), joint)
    best = min(INTERPOLATIONS, key=lambda how: errors[how][0])
    if best == "spline" or errors[best][0] > _CLEARLY * errors["spline"][0]:
        return found
    joint = errors[best][1]
    return found._replace(joint=joint, theta=joint.sharpened(found.theta, case.samples))


def _held_out(joint: JointRecords, theta: np.ndarray, counts: list[int]) -> float:
    """Mean squared residual behind so many samples of each record, over as many at most."""
    total, size = 0.0, 0
    for grid, place, count in zip(joint.grids, joint.vector.places, counts, strict=True):
        left = grid.residuals(theta[place])[count : 2 * count]
        if (np.abs(left) >= BLOWN_UP).any():
            return float("inf")
        total, size = total + float(left @ left), size + len(left)
    return total / max(size, 1)
