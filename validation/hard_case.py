"""Definition of a hard case, measures of its error, and scenes for hard cases."""

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
"""Residual of the energy ledger above which the engine warns that a run is degraded."""

BROKEN = ("EnergyError", "NotFiniteError", "OutsideError")
"""Names of the errors that may end a run with too long a step."""


class ErrorMeasure(NamedTuple):
    """Measure of the error of a finished run, with a description."""

    description: str
    error: Callable[[Trajectory], float]


LEDGER = ErrorMeasure(
    "residual of the energy ledger, relative to the energy turned over",
    lambda run: float(run.settings()["ledger_residual"]),
)


@dataclasses.dataclass(frozen=True)
class HardCase:
    """One case in the catalogue of hard cases."""

    name: str
    difficulty: str
    scene: Callable[[], Scene]
    times: tuple[float, float] = (0.05, 1.0)  # durations of the quick and the full run [s]
    measure: ErrorMeasure = LEDGER
    limit: float = FAIR  # maximum error of an accurate run
    errors: tuple[str, ...] = ()  # names of the errors that may end the run
    dt: float | str = "auto"
    may_degrade: bool = False  # a warning is accepted instead of accuracy


# Errors -----------------------------------------------------------------------------------------

_ENERGIES = ("kinetic", "pair", "wall", "weight", "contact", "piston")


def energy_change(run: Trajectory) -> float:
    """Compute the relative change of the energy over a run without dissipation and external work.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run with one or more records of the energy.

    Returns
    -------
    float
        Magnitude of the change divided by the initial energy (kinetic, pairs, walls, weight, contacts and
        piston), dimensionless; NaN or infinite if the initial energy is 0.
    """
    data = run.dataset
    parts = [data[f"{energy}_energy"].values for energy in _ENERGIES if f"{energy}_energy" in data]
    total = np.sum(parts, axis=0)
    return float(abs(total[-1] / total[0] - 1.0))


def make_distance_from_exact(problem: ExactProblem) -> Callable[[Trajectory], float]:
    """Make a measure of error: the final distance [D] of a run's grains from their exact positions."""

    def measure(run: Trajectory) -> float:
        data = run.dataset
        exact = problem.exact(float(data["frame_time"][-1])).positions
        off = data["position"].values[-1] - exact
        return float(np.abs(off).max()) / Scales.from_grains(run.scene.grains).length

    return measure


def maximum_displacement(run: Trajectory) -> float:
    """Return the maximum displacement [D] of a grain along x or y."""
    positions = run.dataset["position"].values
    return float(np.abs(positions - positions[0]).max()) / Scales.from_grains(run.scene.grains).length


def terminal_fall_error(run: Trajectory) -> float:
    """Return the relative error of the displacement of a falling, overdamped grain."""
    # The exact fall is y = y0 - v t + (v/c)(1 - e^(-c t)) with v = g/c and c = gamma/m.
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
    # A fall smaller than the last digit of the position is measured by its speed.
    by_place = abs(heights[0] - heights[-1] - fallen) - 4.0 * np.spacing(heights[0])
    by_speed = abs(velocity / (speed * math.expm1(-rate * t)) - 1.0)
    return float(max(by_speed, by_place / fallen))


def energy_or_momentum_change(run: Trajectory) -> float:
    """Return the relative change of energy or of momentum over a run, whichever is larger."""
    # Grains have equal thickness, so their masses are proportional to the squares of their diameters.
    charge = (run.scene.grains.diameters() / run.scene.grains.species[0].diameter) ** 2
    momenta = charge[:, None] * run.dataset["velocity"].values
    scale = np.abs(momenta[0]).sum()
    lost = np.abs(momenta[-1].sum(axis=0) - momenta[0].sum(axis=0)).max() / scale
    return max(float(lost), energy_change(run))


def maximum_missing_force(run: Trajectory) -> float:
    """Return the maximum deviation of recorded from recomputed forces, relative to the maximum force."""
    data, worst = run.dataset, 0.0
    for value, height, saved in zip(
        data["position"].values, data["frame_height"].values, data["force"].values, strict=True
    ):
        force = evaluate(run.scene, value, piston_height=float(height)).force
        worst = max(worst, float(np.abs(force - saved).max() / np.abs(force).max()))
    return worst


ENERGY = ErrorMeasure("relative change of the energy", energy_change)
ENERGY_AFTERWARDS = ErrorMeasure("relative change of the energy afterwards", energy_change)
DISPLACEMENT = ErrorMeasure("displacement [D]", maximum_displacement)
MISSING_FORCE = ErrorMeasure("maximum missing force, relative to the maximum force", maximum_missing_force)
FALL = ErrorMeasure("relative error of the fall", terminal_fall_error)
ENERGY_OR_MOMENTUM = ErrorMeasure("relative change of energy or momentum", energy_or_momentum_change)

# Scenes -----------------------------------------------------------------------------------------


def head_on_collision(closest: float) -> ExactProblem:
    """Make the problem of two grains that collide head-on, from 6 D apart.

    Their repulsion stops the grains at a given distance r. The initial speed v follows from the pair energy:
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


def make_wall_shot_scene_maker_and_duration(speed: float) -> tuple[Callable[[], Scene], float]:
    """Return a function that makes the scene of a grain shot at the bottom, and the duration [s]."""
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


def unequal_mass_collision_scene(ratio: float) -> Scene:
    """Make the scene of a light grain shot at a grain that is heavier by a given ratio."""
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


def two_resting_grains_scene(distance: str, **effects: object) -> Scene:
    """Make the scene of two grains of 5 mm at rest, at a distance [D]."""
    positions = [["30 D", "30 D"], [f"{30.0 + float(distance)!r} D", "30 D"]]
    return few_grains_scene("pair", 0.01, {"dipole": {}, **effects}, arrangement={"positions": positions})


def overdamped_grain_scene(ratio: float) -> Scene:
    """Make the scene of a falling grain whose gamma h/m has a given value at the step h = 1 ms."""
    mass = Scales.from_grains(load_scene("single-particle").grains).mass
    effects = {"gravity": {}, "drag": {"coefficient": ratio * mass / 1e-3}}
    scene = few_grains_scene("overdamped", 1.0, effects, arrangement={"positions": [["30 D", "40 D"]]})
    return scene.replace(**{"output.scalars": 1e-3, "output.frames": 0.1})


LINEAR = 1e-6
"""Amplitude divided by the equilibrium height, for runs near the stability limit. It is so small that the
motion is linear to rounding, and its energy is below the threshold of the energy ledger."""


def scene_near_stability_limit(
    fraction: float, amplitude: float = LINEAR
) -> tuple[Callable[[], Scene], float]:
    """Return a function that makes the scene of an oscillating grain, and a step near the stability limit.

    The longest stable step is 2/omega (Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144,
    section 5.1); omega is the angular frequency of a grain about its equilibrium height.

    Parameters
    ----------
    fraction : float
        Step divided by the longest stable step, dimensionless; above 0.
    amplitude : float
        Initial displacement above the equilibrium, divided by the equilibrium height, dimensionless; above
        -1.

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


def make_distance_from_verlet_oscillation(fraction: float, step: float) -> Callable[[Trajectory], float]:
    """Make a measure of a run's deviation from the linear oscillation that Verlet's scheme produces."""
    # In a linear mode Verlet's positions are A cos(n theta) with cos(theta) = 1 - 2 fraction^2, bounded up
    # to a fraction of one (Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144, sec. 5.1).
    angle = math.acos(1.0 - 2.0 * fraction * fraction)

    def measure(run: Trajectory) -> float:
        heights = run.dataset["position"].values[:, 0, 1]
        count = np.rint(run.dataset["frame_time"].values / step)
        rest = heights[0] / (1.0 + LINEAR)
        amplitude = heights[0] - rest
        return float(np.abs(heights - rest - amplitude * np.cos(count * angle)).max() / amplitude)

    return measure


# Packaged scenes -----------------------------------------------------------------------------------------

Changes = Mapping[str, Any]
"""Changes to a packaged scene, by dotted keys."""

FEW = {"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "arrangement.height": "5.5 D"}
MANY = 100_000
_TIMES_WIDER = (MANY / 368.0) ** 0.5

DROP: Changes = {"protocol": [{"kind": "free", "name": "drop", "duration": 60.0}], "output.record": None}
"""Only the first fall of the damper's piston, without a time limit."""

SQUEEZE: Changes = {
    "protocol": [
        {"kind": "move", "name": "squeeze", "to": "1.1 D", "duration": 0.5},
        {"kind": "hold", "name": "hold", "duration": 60.0},
    ]
}
"""The piston descends until the area of the grains exceeds the area of the cell."""

INSIDE: Changes = {
    "grains.count": 92,
    "cell.width": "30 D",
    "piston.height": "10 D",
    "arrangement.height": "12 D",
}
"""De Paula's bed of 92 grains; with these values [D, 3.3] the piston would start inside the bed."""

SLABS = {"left": {}, "right": {}, "bottom": {"law": "slab"}, "top": {"law": "slab"}}
SLABS_WITH_GAP = SLABS | {"bottom": {"law": "slab", "gap_start": "5 D", "gap_end": "10 D"}}
RUBBING: Changes = {"effects.drag": None, "effects.friction": {}}

FAR: Changes = {"pairs.method": "mesh", "pairs.cut_off": "3 D"}
"""Mesh with a cut-off so short that the far field is significant in a bed of 23 grains."""

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
"""At 5 m/s, or 0.8 D in each step of 1 ms, a grain passes between two rows of slow grains."""

PAIR_LIST: Changes = {
    "grains.count": 92,
    "cell.width": "30 D",
    "piston.height": "12 D",
    "arrangement.height": "11 D",
    "effects.drag": None,
}
"""Bed of 92 grains whose pair list is rebuilt as grains move."""

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
"""The packaged bed with 1e5 grains at the same packing, with the mesh sum."""


def make_packaged_scene_maker(name: str, *changes: Changes) -> Callable[[], Scene]:
    """Return a function that makes a packaged scene with changes, applied in order."""
    return lambda: load_scene(name).replace(**{key: value for some in changes for key, value in some.items()})


def make_few_grains_scene_maker(name: str, *changes: Changes) -> Callable[[], Scene]:
    """Return a function that makes a packaged scene with 23 grains and changes."""
    light = {"piston.mass": 1.0} if name == "damper" else {}
    return make_packaged_scene_maker(name, FEW | light, *changes)


def make_mixture_scene_maker(**fractions: tuple[str, float]) -> Callable[[], Scene]:
    """Return a function that makes a bed of several species, each given as name=(diameter, fraction)."""
    species = [
        {"name": name, "diameter": diameter, "share": fraction}
        for name, (diameter, fraction) in fractions.items()
    ]
    return make_few_grains_scene_maker("bed", {"grains.species": species, "effects.drag": None})


def make_slow_compression_scene_maker(changes: Changes) -> Callable[[], Scene]:
    """Return a function that makes de Paula's slow compression of 23 grains, at the first speed [D, 2.3]."""
    return lambda: mono_bed(23, speed=8.33e-3, relaxation=0.1).replace(**changes)


def loaded_grain_scene() -> Scene:
    """Make the scene of a grain with weight that is pressed against the plates by 10 mN."""
    effects = {"gravity": {}, "friction": {"load": 0.01}}
    return few_grains_scene("loaded", 0.5, effects, arrangement={"positions": [["30 D", "30 D"]]})
