"""Hard cases of steps: at the limit of stability, and very many of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.hard_cases.measures import LEDGER, greatest_way, ledger
from validation.outcomes import BROKEN, HardCase

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


def _recorded_rarely() -> Scene:
    return load_scene("single-particle").replace(**{"output.scalars": 0.01, "output.frames": 1.0})


def step_cases() -> tuple[HardCase, ...]:
    """Long steps, and many."""
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
            _recorded_rarely,
            ledger, LEDGER, 1e-6, 1.0, 100.0, dt=1e-6,
        ),
    )  # fmt: skip
