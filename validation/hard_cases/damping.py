"""Hard cases of damping: drags that end a motion within a step."""

from __future__ import annotations

from functools import partial

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.scales import Scales
from validation.exact.problem import lone_scene
from validation.hard_cases.measures import FAIR, LEDGER, ledger, terminal_fall
from validation.hard_cases.small_beds import few_grains
from validation.outcomes import HardCase


def _overdamped(ratio: float) -> Scene:
    """A drag with gamma h/m of that size, at a step of a millisecond: nothing shortens it here."""
    mass = Scales.of(load_scene("single-particle").grains).mass
    effects = {"gravity": {}, "drag": {"coefficient": ratio * mass / 1e-3}}
    scene = lone_scene("overdamped", 1.0, effects, arrangement={"positions": [["30 D", "40 D"]]})
    return scene.replace(**{"output.scalars": 1e-3, "output.frames": 0.1})


def _slowest(drag: float) -> Scene:
    """A small damper, let go above its place of rest."""
    return few_grains("damper", **{"effects.drag.coefficient": drag})


def damping_cases() -> tuple[HardCase, ...]:
    """Drags from weak to overwhelming, and beds that hardly swing."""
    near_one = tuple(
        HardCase(
            f"damping ratio near 1: drag of {drag:g} kg/s",
            "a piston that just swings, or just does not", partial(_slowest, drag),
            ledger, LEDGER, FAIR, 0.2, 3.0,
        )
        for drag in (2.0, 2.7, 4.0)
    )  # fmt: skip
    return near_one + tuple(
        HardCase(
            f"drag with gamma h/m = {ratio:g}", "the velocity decays within a step",
            partial(_overdamped, ratio),
            terminal_fall, "relative error of the fall", 1e-4, 0.1, 1.0,
        )
        for ratio in (1.0, 1e3, 1e6)
    )  # fmt: skip
