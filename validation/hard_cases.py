"""The catalogue of hard cases: what is hard, what counts as accurate, which errors may end it.

Only coincident grains, overlapping starts without contact, injected NaN, a piston started inside
the bed, and steps beyond the stability limit may end in an error. All others run accurately with
the default settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scales import Scales
from granular.scene.scene import Scene
from validation.exact import Problem
from validation.exact.problem import BOTTOM_ONLY, lone_scene
from validation.hard_measures import (
    FAIR,
    LEDGER,
    distance_to,
    energy_change,
    few_grains,
    greatest_way,
    ledger,
    momentum_change,
    terminal_fall,
)
from validation.hard_sums import sum_cases
from validation.outcomes import HardCase

BROKEN = ("EnergyError", "NotFiniteError", "OutsideError")
"""What a step that is too long may end in."""


def _as_it_is(scene: Scene) -> Scene:
    return scene


def _drop(**changes: Any) -> Scene:
    """The damper's first fall alone, up to any time."""
    return load_scene("damper").replace(
        **{
            "protocol": [{"kind": "free", "name": "drop", "duration": 60.0}],
            "output.record": None,
            **changes,
        }
    )


def head_on(closest: float) -> Problem:
    """Two grains head-on at the speed that brings them to a distance [D], from 6 D apart."""
    from validation.exact.scattering import APART, problem

    scales = Scales.of(load_scene("single-particle").grains)
    natural = math.sqrt(0.25 / closest**3 - 0.25 / APART**3)
    time = 1.1 * APART / natural * scales.time
    return problem(natural * scales.velocity, 0.0, time)


def _shot(speed: float) -> Scene:
    """A grain shot at the bottom wall from 20 D [D/tau], and away again."""
    scales = Scales.of(load_scene("single-particle").grains)
    arrangement = {
        "positions": [["30 D", "20 D"]],
        "velocities": [[0.1 * speed * scales.velocity, -speed * scales.velocity]],
    }
    time = 20.0 / speed * scales.time
    return lone_scene(
        "shot",
        2.0 * time,
        {"gravity": {}, "walls": BOTTOM_ONLY},
        arrangement=arrangement,
        cell={"width": "60 D"},
    )


def _pair(gap: str, **effects: Any) -> Scene:
    """Two grains of 5 mm at rest, at a distance."""
    return lone_scene(
        "pair",
        0.01,
        {"dipole": {}, **effects},
        arrangement={"positions": [["30 D", "30 D"], [f"{30.0 + float(gap)!r} D", "30 D"]]},
    )


def _loaded(load: float) -> Scene:
    """A grain under its weight, pressed on the plates [N]."""
    arrangement = {"positions": [["30 D", "30 D"]]}
    return lone_scene(
        "loaded", 0.5, {"gravity": {}, "friction": {"load": load}}, arrangement=arrangement
    )


def _overdamped(ratio: float) -> Scene:
    """A drag with gamma h/m of that size, at a step of a millisecond: nothing shortens it here."""
    mass = Scales.of(load_scene("single-particle").grains).mass
    effects = {"gravity": {}, "drag": {"coefficient": ratio * mass / 1e-3}}
    scene = lone_scene("overdamped", 1.0, effects, arrangement={"positions": [["30 D", "40 D"]]})
    return scene.replace(**{"output.scalars": 1e-3, "output.frames": 0.1})


def _unequal(ratio: float) -> Scene:
    """A light grain shot at a heavy one of that many times its mass."""
    small = 5e-3 / math.sqrt(ratio)
    speed, apart = 0.5, 0.02
    grains = {
        "count": 2,
        "species": [
            {"name": "heavy", "diameter": 5e-3, "share": 0.5},
            {"name": "light", "diameter": small, "share": 0.5},
        ],
    }
    plan = {
        "positions": [["30 D", "30 D"], [0.15 + apart, 0.1502]],
        "velocities": [[0.0, 0.0], [-speed, 0.0]],
    }
    scene = lone_scene("unequal", 2.0 * apart / speed, {"dipole": {}}, arrangement=plan)
    return scene.replace(**{"grains": grains})


def _aspect() -> Scene:
    """A bed of grains of which half are a tenth as wide."""
    return few_grains(
        "bed",
        **{
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.5},
                {"name": "small", "diameter": "0.6 mm", "share": 0.5},
            ],
            "effects.drag": None,
        },
    )


def _squeezed() -> Scene:
    """A bed whose piston comes down until the grains' area is more than the cell's."""
    return few_grains(
        "bed",
        **{
            "protocol": [
                {"kind": "move", "name": "squeeze", "to": "1.1 D", "duration": 0.5},
                {"kind": "hold", "name": "hold", "duration": 60.0},
            ],
        },
    )


LINEAR = 1e-6
"""Swing of the grain near the stability limit, over its height of rest: as wide as the motion is
linear to rounding, and its energy below what the ledger judges."""


def near_limit(share: float, amplitude: float = LINEAR) -> tuple[Callable[[], Scene], float]:
    """A grain where the wall carries it, and that share of the longest stable step, 2/omega.

    Parameters
    ----------
    share : float
    amplitude : float
        Start above the place of rest, in units of its height.
    """
    from validation.exact.oscillation import harmonic_period, problem

    scene = problem(amplitude).scene
    step = share * harmonic_period(scene) / math.pi
    return (lambda: scene.replace(**{"output.scalars": step * 8, "output.frames": step * 64})), step


def verlet_swing(share: float, step: float) -> Callable[[Trajectory], float]:
    """Distance from Verlet's own swing in a linear mode, over its amplitude.

    At a step of that share of 2/omega the places are x_n = A cos(n theta), with cos(theta) =
    1 - 2 share^2: bounded for ever up to a share of one (Hairer, Lubich and Wanner 2003, section
    5.1).
    """
    angle = math.acos(1.0 - 2.0 * share * share)

    def measure(run: Trajectory) -> float:
        place = run.dataset["position"].values[:, 0, 1]
        count = np.rint(run.dataset["frame_time"].values / step)
        rest = place[0] / (1.0 + LINEAR)
        swing = place[0] - rest
        return float(np.abs(place - rest - swing * np.cos(count * angle)).max() / swing)

    return measure


def _inside() -> Scene:
    """The source's N = 92, whose piston would start inside the bed [D, 3.3]."""
    return load_scene("bed").replace(
        **{"grains.count": 92, "cell.width": "30 D", "piston.height": "10 D",
           "arrangement.height": "12 D"}
    )  # fmt: skip


def _slabs(**bottom: Any) -> Scene:
    """Finite magnetic slabs as bottom and piston."""
    walls = {"left": {}, "right": {}, "bottom": {"law": "slab", **bottom}, "top": {"law": "slab"}}
    return few_grains("bed", **{"effects.walls": walls})


def _count(number: int) -> Scene:
    return few_grains("bed", **{"grains.count": number})


def _injected(key: str, value: float) -> Scene:
    wrong: dict[str, Any] = {
        "arrangement.positions": [[0.15, value]],
        "arrangement.velocities": [[0.0, value]],
        "protocol": [{"kind": "hold", "name": "hold", "duration": value}],
    }
    return _bouncing(**{key: wrong.get(key, value)})


def _bouncing(**changes: Any) -> Scene:
    return load_scene("single-particle").replace(**changes)


# The catalogue ----------------------------------------------------------------------------------


def catalogue() -> tuple[HardCase, ...]:
    """All hard cases."""
    return (
        *_pistons(), *_collisions(), *_starts(), *_dry(), *_damped(), *_sizes(), *_steps(),
        *_counts(), *sum_cases(), *_extremes(), *_injections(),
    )  # fmt: skip


def _pistons() -> tuple[HardCase, ...]:
    return (
        HardCase(
            "full-height drop", "the piston falls 55 D before it meets the bed",
            lambda: _drop(**{"piston.height": "75 D"}), ledger, LEDGER, 1e-5, 0.3, 3.0,
        ),
        HardCase(
            "100 kg piston", "thirteen times the damper's mass falls on the bed",
            lambda: _drop(**{"piston.mass": 100.0}), ledger, LEDGER, FAIR, 0.15, 3.0,
        ),
        HardCase(
            "piston inside the bed", "the source's N = 92 [D, 3.3]",
            _inside, ledger, LEDGER, FAIR, 0.05, 0.2, errors=("SceneError",),
        ),
        HardCase(
            "packing above 1", "the grains' area is more than the cell's, without contact",
            _squeezed, ledger, LEDGER, FAIR, 0.55, 2.0,
        ),
        HardCase(
            "slabs under the bed", "a finite magnetic slab as the bottom, another as the piston",
            _slabs, ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
        HardCase(
            "slabs under the bed, with a gap", "grains flow out between two slabs",
            lambda: _slabs(gap_start="5 D", gap_end="10 D"), ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
    )  # fmt: skip


def _collisions() -> tuple[HardCase, ...]:
    found = []
    for closest in (0.5, 0.1, 0.02):
        problem = head_on(closest)
        found.append(
            HardCase(
                f"head-on to {closest:g} D",
                "the pair's stiffness grows like r^-5",
                partial(_as_it_is, problem.scene),
                distance_to(problem),
                "distance from the exact place afterwards [D]",
                1e-2,
                problem.time,
                problem.time,
            )
        )
        found.append(
            HardCase(
                f"head-on to {closest:g} D, energy",
                "the same, judged by its energy",
                partial(_as_it_is, problem.scene),
                energy_change,
                "relative change of the energy afterwards",
                1e-6,
                problem.time,
                problem.time,
            )
        )
    for speed in (1.0, 10.0, 100.0):
        scene = _shot(speed)
        time = scene.protocol[0].span(0.0)
        assert time is not None
        found.append(
            HardCase(
                f"shot at the wall with {speed:g} D/tau",
                "the wall's stiffness grows like w^-4.5",
                partial(_as_it_is, scene),
                energy_change,
                "relative change of the energy afterwards",
                1e-5,
                time,
                time,
            )
        )
    return tuple(found)


def _starts() -> tuple[HardCase, ...]:
    return (
        HardCase(
            "coincident grains", "two grains at one place", lambda: _pair("0.0"), energy_change,
            "relative change of the energy", 1e-6, 0.01, 0.01, errors=("SceneError",),
        ),
        HardCase(
            "nearly coincident grains", "two grains 1e-9 D apart", lambda: _pair("1e-9"),
            energy_change, "relative change of the energy", 1e-6, 0.01, 0.01,
            errors=("SceneError",),
        ),
        HardCase(
            "overlapping start", "two grains 0.8 D apart, without contact", lambda: _pair("0.8"),
            energy_change, "relative change of the energy", 1e-6, 0.01, 0.01,
            errors=("SceneError",),
        ),
        HardCase(
            "overlapping start with contact", "two grains 0.999 D apart, with contact",
            lambda: _pair("0.999", contact={"modulus": 1e8}), ledger, LEDGER, 1e-4, 0.002, 0.01,
        ),
    )  # fmt: skip


def _dry() -> tuple[HardCase, ...]:
    from validation.exact import sliding

    problem = sliding.problem()
    limit = 10.4 * 1e-2**2 / 8.0 / 5e-3  # a h^2/8: see the problem
    return (
        HardCase(
            "friction below the threshold", "the weight is 0.7 of what static friction holds",
            lambda: _loaded(0.01), greatest_way, "way [D]", 0.0, 0.5, 5.0,
        ),
        HardCase(
            "sliding friction", "a grain slides and stops",
            lambda: problem.scene, distance_to(problem), "distance from the exact place [D]",
            1e-2, problem.time, problem.time, dt=1e-3,
        ),
        HardCase(
            "friction, step 100 times too large", "a step of a fifth of the time to the stop",
            lambda: problem.scene.replace(**{"output.scalars": 1e-2, "output.frames": 1e-2}),
            distance_to(problem), "distance from the exact place [D]",
            limit, problem.time, problem.time, dt=1e-2, may_degrade=True,
        ),
        HardCase(
            "bed with dry friction", "many grains stick and slip",
            lambda: few_grains("bed", **{"effects.drag": None, "effects.friction": {}}),
            ledger, LEDGER, 1e-2, 0.2, 2.0,
        ),
        HardCase(
            "bed with dry friction, step 100 times too large", "far beyond the stability limit",
            lambda: few_grains("bed", **{"effects.drag": None, "effects.friction": {},
                                         "output.scalars": 2e-3}),
            ledger, LEDGER, 1e-2, 0.2, 2.0, errors=BROKEN, dt=2e-3, may_degrade=True,
        ),
    )  # fmt: skip


def _damped() -> tuple[HardCase, ...]:
    return tuple(
        HardCase(
            f"drag with gamma h/m = {ratio:g}", "the velocity decays within a step",
            partial(_overdamped, ratio),
            terminal_fall, "relative error of the fall", 1e-4, 0.1, 1.0,
        )
        for ratio in (1.0, 1e3, 1e6)
    )  # fmt: skip


def _sizes() -> tuple[HardCase, ...]:
    masses = tuple(
        HardCase(
            f"mass ratio {ratio:g}", "a light grain bounces off a heavy one",
            partial(_unequal, ratio),
            momentum_change, "relative change of energy or momentum", 1e-5, 0.08, 0.08,
        )
        for ratio in (1e2, 1e4, 1e6)
    )  # fmt: skip
    return (
        *masses,
        HardCase(
            "aspect ratio 0.1", "half of the grains are a tenth as wide [D, 4.1]",
            _aspect, ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
    )  # fmt: skip


def _steps() -> tuple[HardCase, ...]:
    below, short = near_limit(0.95)
    beyond, long = near_limit(1.05)
    return (
        HardCase(
            "step at 0.95 of the stability limit",
            "a grain 5e-6 D off its place of rest swings for ever as Verlet's mode does; the "
            "energy of a wide swing goes up and down tenfold, by 1/(1 - 0.95^2), which the ledger "
            "stops",
            below, verlet_swing(0.95, short), "distance from Verlet's exact swing over its width",
            1e-3, 384 * short, 3840 * short, dt=short,
        ),
        HardCase(
            "step at 1.05 of the stability limit",
            "the same grain's way nearly doubles with each step, until the ledger stops it",
            beyond, greatest_way, "way [D]", 2e-5, 20.0, 200.0, errors=BROKEN, dt=long,
        ),
        HardCase(
            "many steps", "1e6 steps of the bouncing grain; 1e8 in the full catalogue",
            lambda: _bouncing(**{"output.scalars": 0.01, "output.frames": 1.0}),
            ledger, LEDGER, 1e-6, 1.0, 100.0, dt=1e-6,
        ),
    )  # fmt: skip


def _counts() -> tuple[HardCase, ...]:
    return tuple(
        HardCase(
            f"{words}", "sums over grains or pairs are empty",
            partial(_count, number),
            ledger, LEDGER, FAIR, 0.05, 1.0,
        )
        for number, words in ((0, "no grain"), (1, "one grain"), (2, "two grains"))
    )  # fmt: skip


def _extremes() -> tuple[HardCase, ...]:
    cases: dict[str, dict[str, Any]] = {
        "remanence of 1e-4 T": {"grains.remanence": 1e-4},
        "remanence of 100 T": {"grains.remanence": 100.0},
        "density of 1 kg/m^3": {"grains.density": 1.0},
        "density of 1e6 kg/m^3": {"grains.density": 1e6},
        "gravity of 1e4 m/s^2": {"effects.gravity.acceleration": 1e4},
        "no gravity": {"effects.gravity.acceleration": 0.0},
    }
    same = tuple(_extreme(name, 0.5, 2.0, changes) for name, changes in cases.items())
    giants = {
        "grains.species": [{"name": "grain", "diameter": 10.0}],
        "arrangement.positions": [["30 D", "40 D"]],
        "cell.width": "60 D",
        "output.scalars": 0.1,
        "output.frames": 1.0,
    }
    # A fall of 400 m takes nine seconds.
    return (*same, _extreme("grains of 10 m", 20.0, 100.0, giants))


def _extreme(name: str, quick: float, full: float, changes: dict[str, Any]) -> HardCase:
    return HardCase(
        f"extreme: {name}", "extreme but finite", partial(_bouncing, **changes),
        ledger, LEDGER, 1e-4, quick, full,
    )  # fmt: skip


def _injections() -> tuple[HardCase, ...]:
    """A number that is none, in a scene's every kind of number, and as the step."""
    errors = ("SceneError", "FieldError", "InputError")
    keys = {
        "a position": "arrangement.positions",
        "a velocity": "arrangement.velocities",
        "the gravity": "effects.gravity.acceleration",
        "the drag": "effects.drag.coefficient",
        "a duration": "protocol",
    }
    found = []
    for value in (math.nan, math.inf):
        found += [
            HardCase(
                f"injected {value}: {words}", "a number that is none",
                partial(_injected, key, value), ledger, LEDGER, FAIR, 0.1, 0.1, errors=errors,
            )
            for words, key in keys.items()
        ]  # fmt: skip
        found.append(
            HardCase(
                f"injected {value}: the step", "a number that is none", _bouncing,
                ledger, LEDGER, FAIR, 0.1, 0.1, errors=errors, dt=value,
            )
        )  # fmt: skip
    return tuple(found)
