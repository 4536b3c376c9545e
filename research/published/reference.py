"""A short run of each series, by which one sees later whether the code still computes the same.

A faster kernel rounds otherwise, another choice of the step errs otherwise: both stay within the
error of the step. A law that was changed does not.
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
"""By quantity: its value, and the error of the step."""

SPAN = 0.06
"""Length of the run [s]: half of it with the first stage, which is cut short, half with the next.
Grains fall by three diameters, push each other and the walls, and rub; and it is short enough that
what differs in the last digit has not grown."""

FINER = 4.0
"""The reference takes a step that is so much shorter: its own error is to hide no change."""

FRACTION = 2e-3
"""Part of its height that the piston comes down by in the first stage."""

ERRORS = 3.0
"""A value may move by so many errors of the step."""
ROUNDING = 1e-7
"""Or by this much of its size."""


def reference(series: Series) -> Reference:
    """The reference run of a series, from its first start.

    The error of a value is what half the step changes.
    """
    scene = _short(series.scene(series.seeds[0]))
    integer, halved = (_run(scene, _finer(series.step, by)) for by in (FINER, 2.0 * FINER))
    return {name: [value, abs(value - halved[name])] for name, value in integer.items()}


def agrees(former: Mapping[str, list[float]], present: Mapping[str, list[float]]) -> bool:
    """Whether two references are of the same laws."""
    if set(former) != set(present):
        return False
    return all(
        abs(former[name][0] - value) <= ERRORS * max(error, former[name][1]) + ROUNDING * abs(value)
        for name, (value, error) in present.items()
    )


def _short(scene: Scene) -> Scene:
    """The scene with its first stage cut to half of `SPAN`, and to a little of its way."""
    stages, height = scene.to_plain()["protocol"], scene.piston and scene.piston.height
    if stages[0]["kind"] == "descend" and height:
        stages[0] |= {"duration": 0.5 * SPAN, "to": (1.0 - FRACTION) * height}
    output = {"scalars": SPAN / 4.0, "frames": SPAN}
    return scene.replace(protocol=stages[:2], output=output, name="reference")


def _finer(step: float | str, by: float) -> float | str:
    """A step, given in seconds or as a multiple of the automatic one, over a number."""
    asked = parse_time_step(step)
    return f"auto/{by / asked.factor:.6f}" if asked.seconds is None else asked.seconds / by


def _run(scene: Scene, step: float | str) -> dict[str, float]:
    """Energies, forces on the walls and where the grains are, at the end."""
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
