"""De Paula's law and a linear law, fitted to a damper's oscillation."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.records.record import PistonRecord
from granular.scene.scene import Scene
from validation.measured_quantities import published_value

LAW = "z'' + 2*alpha*(z**2 - 2*z)*z' + omega**2*z = g0"
"""[D, eq. 5.12], in the unscaled height."""
LINEAR = "z'' + 2*lam*z' + omega**2*z = g0"
LENGTH = 1.0
"""Duration of the fit [s]: at de Paula's damping the piston is at rest well before its end."""


def heights_in_source_scaling(heights: np.ndarray, rest: float) -> np.ndarray:
    """Return heights in the scaling of [D, Fig. 5.12], whatever their unit.

    In that scaling the motion begins at z = 1 and ends at z = g0/omega^2 = -0.907, which determines shift and
    scale.
    """
    law = published_value("damper.van_der_pol_like")
    low = law["g0"] / law["omega"] ** 2
    return low + (law["z0"] - low) * (heights - rest) / (heights[0] - rest)


def oscillation_figures(record: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
    """Return equilibrium, period and damping of the small oscillation, and residuals of the laws.

    Returns
    -------
    dict
        ``alpha``, ``omega`` [1/s] and ``g0`` of de Paula's law in its scaling, from rest at z = 1;
        ``alpha_over_omega`` and ``g0_over_omega2``, which are dimensionless; ``unit``, the unit of time [s]
        in which omega has the printed value; ``misfit`` and ``linear_misfit``, residuals of the laws over the
        rms displacement there; ``free_misfit`` and ``free_linear_misfit``, with shift, scale and start also
        fitted; ``swing_z``, some of the heights in de Paula's scaling.
    """
    diameter = scene.grains.species[0].diameter
    times, heights = (np.array(record["swing"][name]) for name in ("times", "heights"))
    chosen = times <= LENGTH
    times, heights = times[chosen], heights[chosen]
    rest = record["rest_height"]
    scaled = PistonRecord(time=times, height=heights_in_source_scaling(heights, rest))
    plain = PistonRecord(time=times, height=heights)
    start = {"height": 1.0, "velocity": 0.0}
    source, linear = (_fit_law_without_warnings(scaled, law, start) for law in (LAW, LINEAR))
    free, free_linear = (_fit_law_without_warnings(plain, law) for law in ("van-der-pol-like", "linear"))
    alpha, omega, g0 = (source.parameters[name] for name in ("alpha", "omega", "g0"))
    small = free_linear.at_rest
    return {
        "rest_height_D": rest / diameter,
        "nudge_D": record["nudge"] / diameter,
        "period": float("nan") if small is None else small.period,
        "damping_ratio": float("nan") if small is None else small.damping_ratio,
        "alpha": alpha,
        "omega": abs(omega),
        "g0": g0,
        "alpha_over_omega": alpha / abs(omega),
        "g0_over_omega2": g0 / omega**2,
        "unit": published_value("damper.van_der_pol_like.omega") / abs(omega),
        "ratio_of_source_law": _damping_ratio_or_nan(source),
        "misfit": source.quality.relative,
        "linear_misfit": linear.quality.relative,
        "free_misfit": free.quality.relative,
        "free_linear_misfit": free_linear.quality.relative,
        "swing_z": heights_in_source_scaling(heights, rest)[:: max(1, len(heights) // 100)],
    }


def _damping_ratio_or_nan(model: Any) -> float:
    return float("nan") if model.at_rest is None else float(model.at_rest.damping_ratio)


def _fit_law_without_warnings(
    record: PistonRecord, law: str, initial: Mapping[str, float] | None = None
) -> Any:
    from reduced_models import FitOptions, fit

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit(record, law, test_fraction=0.0, options=FitOptions(initial=initial))
