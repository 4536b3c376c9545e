"""Figures that need no simulated bed: constants, the single grain, the slab, the oscillator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.files import ResultCache
from granular.studies.cases import measure_identity

Numbers = dict[str, float]

_COARSE = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 0.9, 1.0)

TIMED_SIZES = (368, 460, 552, 644, 736)
SOURCE_RADIUS = 11.26
"""Radius of de Paula's list [D]."""

OSCILLATOR_SPAN = 30.0
"""Length of the record of de Paula's demonstration, which is not printed."""


def compute_default_grain_mass_moment_and_distance(_: bool) -> Numbers:
    """Return mass [kg], moment [A m^2], and distance at which the pair force equals the weight [D]."""
    from granular.schema.natural_units import Scales

    grains = load_scene("bed").grains
    scales = Scales.from_grains(grains)
    volume = math.pi / 4.0 * grains.thickness * grains.species[0].diameter ** 2
    weight = scales.mass * 9.8 / (scales.mass * scales.acceleration)
    return {
        "mass_kg": scales.mass,
        "moment_A_m2": grains.remanence * volume / (4e-7 * math.pi),
        "distance_where_force_is_weight": (0.75 / weight) ** 0.25,
    }


def compute_mixture_packing_fraction_and_heights(_: bool) -> Numbers:
    """Return the packing fraction of mixtures at full compression (equal for all R), and heights."""
    from granular.observables import packing_fraction
    from granular.scene.named_scenes import bidisperse

    def final_height_of_compression(scene: Scene) -> float:
        result = scene.protocol[1].prescribed_final_height()
        assert result is not None
        return result

    scenes = [bidisperse(a, r) for a in (0.5, 0.6, 0.75) for r in (0.0, 0.5, 1.0)]
    values = [
        packing_fraction(s.grains.diameters(), s.cell.width, final_height_of_compression(s)) for s in scenes
    ]
    return {"packing_fraction": float(np.mean(values)), "deviation": float(np.ptp(values))}


HEIGHTS: Mapping[str, tuple[float, float, tuple[float, ...]]] = {
    "three_fifths": (0.6, 0.005, (0.0, 0.01, *(0.05 * k for k in range(1, 20)), 0.99, 1.0)),
    "half": (0.5, 0.005, _COARSE),
    "six_eighths": (0.75, 0.008, _COARSE),
    "three_quarters": (0.75, 0.005, _COARSE),
}
"""Rows of Table A.1: aspect ratio, big diameter [m], and every R."""


def compute_final_heights_of_mixtures(_: bool) -> Numbers:
    """Return the piston heights at full compression [D] for all rows of Table A.1."""
    from granular.scene.named_scenes import bidisperse

    made = {}
    for name, (aspect, big, ratios) in HEIGHTS.items():
        for index, ratio in enumerate(ratios):
            end = bidisperse(aspect, round(ratio, 2), big=big).protocol[1].prescribed_final_height()
            assert end is not None
            made[f"{name}[{index}]"] = end / big
    return made


def run_bouncing_grain_test(full: bool) -> Numbers:
    """Run de Paula's test of Verlet's method; the finest steps are run only in the full calculation."""
    from validation.depaula_step_test import COMPENSATED, PLAIN, run_depaula_step_test

    result = run_depaula_step_test(full=full)
    finest = result.runs_of_form(PLAIN)[-1]
    clean = result.runs_of_form(COMPENSATED)[-1]
    assert finest.peak_height_range is not None
    assert clean.peak_height_range is not None
    return {
        "slope": result.error_slope(COMPENSATED),
        "slope_to_finest": result.slope_relative_to_finest(PLAIN),
        "step": finest.step,
        "peak_difference": finest.peak_height_range,
        "peak_difference_compensated": clean.peak_height_range,
    }


def fit_slab_force_exponent(_: bool) -> Numbers:
    """Return the mean exponent of y = a x^b fitted to the slab's force, as in [D, Fig. 3.15].

    L = 100 D, f from 0.005 to 0.995 in steps of 0.01, distances from 0.5 to 59 D in steps of 0.01.
    """
    from scipy.optimize import curve_fit

    from granular.effects.wall_laws import slab_normal_force

    distances = np.arange(0.5, 59.005, 0.01)
    fitted, logarithmic = [], []
    for fraction in np.arange(0.005, 0.9951, 0.01):
        ends = 100.0 * fraction, 100.0 * (1.0 - fraction)
        force = np.array([slab_normal_force(w, *ends) for w in distances])
        start = (force[0] * 0.125, -3.0)
        fitted.append(curve_fit(lambda x, a, b: a * x**b, distances, force, p0=start)[0][1])
        logarithmic.append(np.polyfit(np.log(distances), np.log(force), 1)[0])
    return {"exponent": float(np.mean(fitted)), "logarithmic": float(np.mean(logarithmic))}


def fit_oscillator_demonstration(_: bool) -> Numbers:
    """Fit the demonstration of [D, eq. 5.8], with its motion computed from the formula."""
    from granular.records.record import PistonRecord
    from reduced_models import fit

    t = np.linspace(0.0, OSCILLATOR_SPAN, 1501)
    z = np.cos(t - 0.0996) * np.exp(0.0503 * (0.0996 - t))
    model = fit(PistonRecord(time=t, height=z), law="z'' + 2*lam*z' + omega**2*z = 0")
    lam, omega = model.parameters["lam"], abs(model.parameters["omega"])
    return {"decay": lam, "frequency": math.sqrt(omega**2 - lam**2)}


def measure_pair_sum_times(_: bool) -> Numbers:
    """Measure the processor time of a pair sum [us], by the plain loop and by a plain list.

    Positions of a bed at full compression; the list is de Paula's, 11.26 D. It is not rebuilt: at de Paula's
    step grains need about a hundred thousand steps to cross its skin.
    """
    from research.published.plain_loops import measure_direct_and_list_sum_times as times

    made = {}
    for count in TIMED_SIZES:
        positions = _bed_scene_under_held_piston(count).initial_positions_and_velocities()[0] / 0.006
        made[f"direct {count}"], made[f"list {count}"] = times(positions, SOURCE_RADIUS)
    return made


def _bed_scene_under_held_piston(count: int) -> Scene:
    size = math.sqrt(count / 368.0)
    return load_scene("bed").replace(
        **{
            "grains.count": count,
            "cell.width": f"{60.0 * size} D",
            "piston.height": f"{20.0 * size} D",
            "arrangement.height": f"{19.0 * size} D",
        }
    )


def run_symbolic_regression_of_oscillator(_: bool) -> Numbers:
    """Return the result of a symbolic regression of z(t) in the demonstration of [D, eq. 5.8].

    pyoperon replaces de Paula's PySR, which needs Julia; the result is empty if pyoperon is not installed.
    """
    from research.published.symbolic import fit_oscillation_by_symbolic_regression

    try:
        return fit_oscillation_by_symbolic_regression(OSCILLATOR_SPAN)
    except ImportError:
        return {}


def compute_distances_with_late_velocity(full: bool) -> Numbers:
    """Return starts and ends with the velocity of [D, eq. 2.17] a step late; only in the full run."""
    from research.published.plan import SIZES
    from research.published.velocity_variants import half_mean_distances_of_beds_with_both_causes

    return half_mean_distances_of_beds_with_both_causes(SIZES) if full else {}


def compute_fall_prediction_errors(full: bool) -> Numbers:
    """Return the errors for many falls of a law fitted to one fall; only in the full run."""
    from research.published.falls import prediction_errors_of_falls

    return prediction_errors_of_falls() if full else {}


CALCULATIONS: Mapping[str, Callable[[bool], Numbers]] = {
    "default_grain": compute_default_grain_mass_moment_and_distance,
    "packing": compute_mixture_packing_fraction_and_heights,
    "final_heights": compute_final_heights_of_mixtures,
    "single_particle": run_bouncing_grain_test,
    "slab_exponent": fit_slab_force_exponent,
    "oscillator": fit_oscillator_demonstration,
    "loop_times": measure_pair_sum_times,
    "symbolic": run_symbolic_regression_of_oscillator,
    "late_velocity": compute_distances_with_late_velocity,
    "falls": compute_fall_prediction_errors,
}


def make_missing_calculations(directory: Path, *, full: bool) -> None:
    """Make all calculations that are not yet cached in ``directory``.

    The result for the single grain depends on ``full``, and is stored separately. A calculation whose code
    has changed is repeated.
    """
    cache = _calculation_cache(directory)
    for name, calculation in CALCULATIONS.items():
        if cache.read(_calculation_cache_key(name, full)) is None:
            cache.store(_calculation_cache_key(name, full), calculation(full))


def read_cached_calculations(directory: Path) -> dict[str, Numbers]:
    """Return the cached calculations of a directory, full ones in preference to quick ones."""
    cache = _calculation_cache(directory)
    result = {
        name: [cache.read(_calculation_cache_key(name, full)) for full in (True, False)]
        for name in CALCULATIONS
    }
    return {name: full or quick for name, (full, quick) in result.items() if full or quick}


def _calculation_cache(directory: Path) -> ResultCache:
    return ResultCache(directory / "calculations")


def _calculation_cache_key(name: str, full: bool) -> str:
    calculation: Any = CALCULATIONS[name]
    code = measure_identity(calculation).partition("#")[2]
    return f"{name}-{'full' if full else 'quick'}-{code}"
