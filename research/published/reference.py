"""Short reference run of each series, by which later versions of the code are tested.

A faster kernel changes rounding errors, and another time step changes its error. Both changes remain within
the error of the step, but a changed law does not.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping

from granular.run.plan import parse_time_step
from granular.scene.scene import Scene
from granular.shared.errors import GranularError
from research.published.series import Series

Reference = dict[str, list[float]]
"""Value and step error by quantity."""

SPAN = 0.06
"""Duration of the run [s]: half of it in the shortened first stage, half in the next. Grains fall by three
diameters, collide with each other and the walls, and rub; and it is short enough that differences in the last
digit have not grown."""

FINER = 4.0
"""The reference uses a step shorter by this factor, so that its error does not hide a change."""

FRACTION = 2e-3
"""Fraction of its height by which the piston descends in the first stage."""

ERRORS = 3.0
"""A value may change by this many step errors."""
ROUNDING = 1e-7
"""Or by this fraction of its size."""


def run_reference(series: Series) -> Reference:
    """Run the reference of a series, from its first start.

    The error of a value is its change with half the step.
    """
    scene = _shortened_scene(series.scene(series.seeds[0]))
    integer, halved = (
        _run_and_measure_end_state(scene, _divide_step(series.step, by)) for by in (FINER, 2.0 * FINER)
    )
    return {name: [value, abs(value - halved[name])] for name, value in integer.items()}


def references_agree(former: Mapping[str, list[float]], present: Mapping[str, list[float]]) -> bool:
    """Return True if two references agree, that is, come from the same laws."""
    if set(former) != set(present):
        return False
    return all(
        abs(former[name][0] - value) <= ERRORS * max(error, former[name][1]) + ROUNDING * abs(value)
        for name, (value, error) in present.items()
    )


def _shortened_scene(scene: Scene) -> Scene:
    """Return the scene with its first stage cut to half of `SPAN` and a small part of its travel."""
    stages, height = scene.to_plain()["protocol"], scene.piston and scene.piston.height
    if stages[0]["kind"] == "descend" and height:
        stages[0] |= {"duration": 0.5 * SPAN, "to": (1.0 - FRACTION) * height}
    output = {"scalars": SPAN / 4.0, "frames": SPAN}
    return scene.replace(protocol=stages[:2], output=output, name="reference")


def _divide_step(step: float | str, by: float) -> float | str:
    """Return a step, in seconds or as a multiple of the automatic step, divided by a number."""
    asked = parse_time_step(step)
    return f"auto/{by / asked.factor:.6f}" if asked.seconds is None else asked.seconds / by


def _run_and_measure_end_state(scene: Scene, step: float | str) -> dict[str, float]:
    """Return energies, forces on the walls and positions of the grains, at the end."""
    from granular.observables import mean_pair_distance
    from granular.run.simulation import simulate

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = simulate(scene, dt=step, t_end=SPAN, threads=1, progress=False)
    except GranularError:
        return {}
    data = run.dataset
    names = [str(name) for name in data if str(name).endswith(("_energy", "_force", "_loss"))]
    positions = data["position"].values[-1]
    result = {name: float(data[name].values[-1]) for name in names}
    result["mean_distance"] = mean_pair_distance(positions)
    result["mean_height"] = float(positions[:, 1].mean())
    return {name: value for name, value in result.items() if math.isfinite(value)}
