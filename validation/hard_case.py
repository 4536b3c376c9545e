"""A hard case, the errors that are measured in hard cases, and scenes of one grain and of two."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from granular.run.evaluation import evaluate
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import load_scene, mono_bed
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation.exact_problems import APART, ExactProblem, scattering_problem
from validation.exact_solution import BOTTOM_ONLY, few_grains_scene, harmonic_period, oscillation_problem

FAIR = 1e-4
"""Residual of the ledger beyond which the engine itself calls a run degraded."""

BROKEN = ("EnergyError", "NotFiniteError", "OutsideError")
"""Errors that a step that is too long may end in."""


class ErrorMeasure(NamedTuple):
    """An error of a finished run."""

    description: str
    error: Callable[[Trajectory], float]


LEDGER = ErrorMeasure(
    "residual of the energy ledger over the energy turned over",
    lambda run: float(run.settings()["ledger_residual"]),
)


@dataclasses.dataclass(frozen=True)
class HardCase:
    """One entry of the catalogue."""

    name: str
    difficulty: str
    scene: Callable[[], Scene]
    times: tuple[float, float] = (0.05, 1.0)  # quick and full [s]
    measure: ErrorMeasure = LEDGER
    limit: float = FAIR  # error up to which the run is accurate
    errors: tuple[str, ...] = ()  # names of those that may end it
    dt: float | str = "auto"
    may_degrade: bool = False  # a warning may take the place of accuracy


# Errors -----------------------------------------------------------------------------------------

_ENERGIES = ("kinetic", "pair", "wall", "weight", "contact", "piston")


def energy_change(run: Trajectory) -> float:
    """Compute the relative change of the energy over a run in which nothing is lost and no work done.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off, with at least one record of an energy.

    Returns
    -------
    float
        Magnitude of the change over the energy at the start (kinetic, pairs, walls, weight, contacts and
        piston), without unit; NaN or infinite where that is 0.
    """
    data = run.dataset
    parts = [data[f"{energy}_energy"].values for energy in _ENERGIES if f"{energy}_energy" in data]
    total = np.sum(parts, axis=0)
    return float(abs(total[-1] / total[0] - 1.0))


def make_distance_from_exact(problem: ExactProblem) -> Callable[[Trajectory], float]:
    """Make the measure of the distance from a problem's exact place at the run's end [D]."""

    def measure(run: Trajectory) -> float:
        data = run.dataset
        exact = problem.exact(float(data["frame_time"][-1])).positions
        off = data["position"].values[-1] - exact
        return float(np.abs(off).max()) / Scales.from_grains(run.scene.grains).length

    return measure


def greatest_displacement(run: Trajectory) -> float:
    """Greatest displacement of any grain along an axis [D]."""
    positions = run.dataset["position"].values
    return float(np.abs(positions - positions[0]).max()) / Scales.from_grains(run.scene.grains).length


def terminal_fall_error(run: Trajectory) -> float:
    """Relative error of an overdamped grain's fall."""
    # Against y = y0 - v t + (v/c)(1 - e^(-c t)), v = g/c, c = gamma/m.
    drag, gravity = run.scene.effects.drag, run.scene.effects.gravity
    assert drag is not None
    assert gravity is not None
    rate = drag.coefficient / Scales.from_grains(run.scene.grains).mass
    data = run.dataset
    t = float(data["frame_time"][-1])
    speed = gravity.acceleration / rate
    fallen = speed * t + speed / rate * math.expm1(-rate * t)
    velocity = float(data["velocity"].values[-1, 0, 1])
    heights = data["position"].values[:, 0, 1]
    # A fall of less than the place's last digits can only be told by its speed.
    by_place = abs(heights[0] - heights[-1] - fallen) - 4.0 * np.spacing(heights[0])
    by_speed = abs(velocity / (speed * math.expm1(-rate * t)) - 1.0)
    return float(max(by_speed, by_place / fallen))


def energy_or_momentum_change(run: Trajectory) -> float:
    """Compute the greater of the relative changes of energy and momentum over a run."""
    # Grains are equally thick: their masses go with the squares of their diameters.
    charge = (run.scene.grains.diameters() / run.scene.grains.species[0].diameter) ** 2
    momenta = charge[:, None] * run.dataset["velocity"].values
    scale = np.abs(momenta[0]).sum()
    lost = np.abs(momenta[-1].sum(axis=0) - momenta[0].sum(axis=0)).max() / scale
    return max(float(lost), energy_change(run))


def greatest_missing_force(run: Trajectory) -> float:
    """Greatest force on a grain that a frame lacks, against lists made for that frame alone."""
    data, worst = run.dataset, 0.0
    for value, height, saved in zip(
        data["position"].values, data["frame_height"].values, data["force"].values, strict=True
    ):
        force = evaluate(run.scene, value, piston_height=float(height)).force
        worst = max(worst, float(np.abs(force - saved).max() / np.abs(force).max()))
    return worst


ENERGY = ErrorMeasure("relative change of the energy", energy_change)
ENERGY_AFTERWARDS = ErrorMeasure("relative change of the energy afterwards", energy_change)
DISPLACEMENT = ErrorMeasure("displacement [D]", greatest_displacement)
MISSING_FORCE = ErrorMeasure("greatest force missed, over the greatest force", greatest_missing_force)
FALL = ErrorMeasure("relative error of the fall", terminal_fall_error)
ENERGY_OR_MOMENTUM = ErrorMeasure("relative change of energy or momentum", energy_or_momentum_change)

# Scenes -----------------------------------------------------------------------------------------


def head_on_collision(closest: float) -> ExactProblem:
    """Make the problem of two grains that collide head-on, from 6 D apart.

    Their speed v is that at which the dipoles stop them at a given distance r, by the pair's energy:
    v^2 = (1/r^3 - 1/6^3)/4 in natural units.

    Parameters
    ----------
    closest : float
        Closest distance of the centres [D], above 0 and below 6.

    Returns
    -------
    ExactProblem
        Scene with its exact solution.

    Raises
    ------
    InputError
        If the distance is out of its limits.
    """
    if not 0.0 < closest < APART:
        raise InputError(f"closest = {closest} D; give a distance above 0 and below {APART:g} D")
    scales = Scales.from_grains(load_scene("single-particle").grains)
    natural = math.sqrt(0.25 / closest**3 - 0.25 / APART**3)
    return scattering_problem(natural * scales.velocity, 0.0, 1.1 * APART / natural * scales.time)


def shot_at_wall(speed: float) -> tuple[Callable[[], Scene], float]:
    """Scene of a grain shot at the bottom wall from 20 D, and away again, and its time [s]; speed [D/tau]."""
    scales = Scales.from_grains(load_scene("single-particle").grains)
    velocity = [0.1 * speed * scales.velocity, -speed * scales.velocity]
    time = 40.0 / speed * scales.time
    scene = few_grains_scene(
        "shot",
        time,
        {"gravity": {}, "walls": BOTTOM_ONLY},
        arrangement={"positions": [["30 D", "20 D"]], "velocities": [velocity]},
    )
    return scene.replace, time


def unequal_masses(ratio: float) -> Scene:
    """Light grain shot at a heavy one of that many times its mass."""
    speed, apart = 0.5, 0.02
    plan = {
        "positions": [["30 D", "30 D"], [0.15 + apart, 0.1502]],
        "velocities": [[0.0, 0.0], [-speed, 0.0]],
    }
    species = [
        {"name": "heavy", "diameter": 5e-3, "share": 0.5},
        {"name": "light", "diameter": 5e-3 / math.sqrt(ratio), "share": 0.5},
    ]
    scene = few_grains_scene("unequal", 2.0 * apart / speed, {"dipole": {}}, arrangement=plan)
    return scene.replace(**{"grains": {"count": 2, "species": species}})


def two_grains_at_rest(distance: str, **effects: object) -> Scene:
    """Two grains of 5 mm at rest, at a distance [D]."""
    positions = [["30 D", "30 D"], [f"{30.0 + float(distance)!r} D", "30 D"]]
    return few_grains_scene("pair", 0.01, {"dipole": {}, **effects}, arrangement={"positions": positions})


def overdamped_grain(ratio: float) -> Scene:
    """Drag with gamma h/m of that size, at a step of a millisecond: nothing shortens it here."""
    mass = Scales.from_grains(load_scene("single-particle").grains).mass
    effects = {"gravity": {}, "drag": {"coefficient": ratio * mass / 1e-3}}
    scene = few_grains_scene("overdamped", 1.0, effects, arrangement={"positions": [["30 D", "40 D"]]})
    return scene.replace(**{"output.scalars": 1e-3, "output.frames": 0.1})


LINEAR = 1e-6
"""Swing of the grain near the stability limit, over its height of rest: as wide as the motion is
linear to rounding, and its energy below what the ledger judges."""


def scene_near_stability_limit(
    fraction: float, amplitude: float = LINEAR
) -> tuple[Callable[[], Scene], float]:
    """Make a scene of a swinging grain, with a fraction of the longest step at which Verlet is stable.

    That step is 2/omega, by Hairer, Lubich and Wanner (2003, doi:10.1017/S0962492902000144), section
    5.1; omega is the angular frequency of a grain about the height at which the wall carries it.

    Parameters
    ----------
    fraction : float
        Step over the longest stable one, without unit; above 0.
    amplitude : float
        Height of the start above that of rest, over that of rest, without unit; above -1.

    Returns
    -------
    tuple of function and float
        Function that makes the scene, and the step [s]. The function raises SceneError for a
        ``fraction`` that is not above 0.

    Raises
    ------
    SceneError
        If the amplitude puts the grain into the bottom.
    """
    scene = oscillation_problem(amplitude).scene
    step = fraction * harmonic_period(scene) / math.pi
    return (lambda: scene.replace(**{"output.scalars": step * 8, "output.frames": step * 64})), step


def distance_from_verlet_swing(fraction: float, step: float) -> Callable[[Trajectory], float]:
    """Make the measure of the distance from Verlet's own swing in a linear mode; step [s]."""
    # In a linear mode Verlet's places are A cos(n theta) with cos(theta) = 1 - 2 fraction^2, bounded for ever
    # up to a fraction of one (Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144, sec. 5.1).
    angle = math.acos(1.0 - 2.0 * fraction * fraction)

    def measure(run: Trajectory) -> float:
        heights = run.dataset["position"].values[:, 0, 1]
        count = np.rint(run.dataset["frame_time"].values / step)
        rest = heights[0] / (1.0 + LINEAR)
        swing = heights[0] - rest
        return float(np.abs(heights - rest - swing * np.cos(count * angle)).max() / swing)

    return measure


# Packaged scenes -----------------------------------------------------------------------------------------

Changes = Mapping[str, Any]
"""Changes to a packaged scene, by dotted keys."""

FEW = {"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "arrangement.height": "5.5 D"}
MANY = 100_000
_TIMES_WIDER = (MANY / 368.0) ** 0.5

DROP: Changes = {"protocol": [{"kind": "free", "name": "drop", "duration": 60.0}], "output.record": None}
"""Damper's first fall alone, up to any time."""

SQUEEZE: Changes = {
    "protocol": [
        {"kind": "move", "name": "squeeze", "to": "1.1 D", "duration": 0.5},
        {"kind": "hold", "name": "hold", "duration": 60.0},
    ]
}
"""Piston descends until the grains' area is more than the cell's."""

INSIDE: Changes = {
    "grains.count": 92,
    "cell.width": "30 D",
    "piston.height": "10 D",
    "arrangement.height": "12 D",
}
"""De Paula's N = 92, whose piston would start inside the bed [D, 3.3]."""

SLABS = {"left": {}, "right": {}, "bottom": {"law": "slab"}, "top": {"law": "slab"}}
SLABS_WITH_GAP = SLABS | {"bottom": {"law": "slab", "gap_start": "5 D", "gap_end": "10 D"}}
RUBBING: Changes = {"effects.drag": None, "effects.friction": {}}

FAR: Changes = {"pairs.method": "mesh", "pairs.cut_off": "3 D"}
"""A far field that matters in a bed of 23 grains."""

RESONANT: Changes = {
    **FAR,
    "pairs.far_every": 128,
    "effects.drag": None,
    "output.scalars": 0.02,
    "output.frames": 0.1,
}

SLOW_ROWS = [[f"{x} D", f"{y} D"] for y in (8, 30) for x in range(6, 60, 6)]

FAST_GRAIN: Changes = {
    "grains.count": len(SLOW_ROWS) + 1,
    "cell.width": "60 D",
    "piston.height": "40 D",
    "effects.drag": None,
    "arrangement": {
        "positions": [["3 D", "12 D"], *SLOW_ROWS],
        "velocities": [["5 m/s", 0.0], *([0.0, 0.0] for _ in SLOW_ROWS)],
    },
    "pairs": {"method": "cut-off", "cut_off": "6 D"},
    "output": {"scalars": 1e-3, "frames": 1e-3},
}
"""Grain at 5 m/s, 0.8 D in a step of 1 ms, flies past two rows of slow ones."""

PAIR_LIST: Changes = {
    "grains.count": 92,
    "cell.width": "30 D",
    "piston.height": "12 D",
    "arrangement.height": "11 D",
    "effects.drag": None,
}
"""Bed of 92 grains whose list is made anew as its grains move."""

DEPAULA_SCHEME: Changes = {
    "effects.drag": None,
    "effects.friction": {"scheme": "regularised"},
    "pairs": {"method": "verlet-list", "cut_off": "5 D", "skin": "1 D"},
}

MANY_GRAINS: Changes = {
    "grains.count": MANY,
    "cell.width": f"{60.0 * _TIMES_WIDER} D",
    "piston.height": f"{20.0 * _TIMES_WIDER} D",
    "arrangement.height": f"{20.0 * _TIMES_WIDER - 1.0} D",
    "pairs.method": "mesh",
    "output": {"scalars": 1e-4, "frames": 1e-3},
}
"""The packaged bed with 1e5 grains at the same packing, by the mesh."""


def packaged_scene(name: str, *changes: Changes) -> Callable[[], Scene]:
    """Scene of the package with changes, the later ones last."""
    return lambda: load_scene(name).replace(**{key: value for some in changes for key, value in some.items()})


def few_grains(name: str, *changes: Changes) -> Callable[[], Scene]:
    """Scene of the package cut down to 23 grains, with changes."""
    light = {"piston.mass": 1.0} if name == "damper" else {}
    return packaged_scene(name, FEW | light, *changes)


def mixture(**fractions: tuple[str, float]) -> Callable[[], Scene]:
    """Bed of several species: diameter and fraction of each, by its name."""
    species = [
        {"name": name, "diameter": diameter, "share": fraction}
        for name, (diameter, fraction) in fractions.items()
    ]
    return few_grains("bed", {"grains.species": species, "effects.drag": None})


def slow_compression(changes: Changes) -> Callable[[], Scene]:
    """De Paula's slow compression of a bed of 23 grains, at its first speed [D, 2.3]."""
    return lambda: mono_bed(23, speed=8.33e-3, relaxation=0.1).replace(**changes)


def loaded_grain() -> Scene:
    """Grain under its weight, pressed on the plates by 10 mN."""
    effects = {"gravity": {}, "friction": {"load": 0.01}}
    return few_grains_scene("loaded", 0.5, effects, arrangement={"positions": [["30 D", "30 D"]]})
