"""Hard cases of the sums over pairs: lists that grains outrun, a far field at longer steps."""

from __future__ import annotations

from functools import partial

import numpy as np

from granular.run.evaluation import evaluate
from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.hard_cases.measures import FAIR, LEDGER, ledger
from validation.hard_cases.small_beds import few_grains
from validation.outcomes import HardCase


def missed(run: Trajectory) -> float:
    """Greatest force on a grain that a frame lacks, against lists made for that frame alone."""
    data, worst = run.dataset, 0.0
    for places, height, found in zip(
        data["position"].values, data["frame_height"].values, data["force"].values, strict=True
    ):
        force = evaluate(run.scene, places, piston_height=float(height)).force
        worst = max(worst, float(np.abs(force - found).max() / np.abs(force).max()))
    return worst


FAR = {"pairs.method": "mesh", "pairs.cut_off": "3 D"}
"""A far field that matters in a bed of 23 grains."""


def _flight() -> Scene:
    """A grain at 5 m/s, 0.8 D in a step of 1 ms, flies past two rows of slow ones."""
    rows = [[f"{x} D", f"{y} D"] for y in (8, 30) for x in range(6, 60, 6)]
    return few_grains(
        "bed",
        **{
            "grains.count": len(rows) + 1,
            "cell.width": "60 D",
            "piston.height": "40 D",
            "effects.drag": None,
            "arrangement": {
                "positions": [["3 D", "12 D"], *rows],
                "velocities": [["5 m/s", 0.0], *([0.0, 0.0] for _ in rows)],
            },
            "pairs": {"method": "cut-off", "cut_off": "6 D"},
            "output": {"scalars": 1e-3, "frames": 1e-3},
        },
    )


def _with_list(radius: float) -> Scene:
    """A bed of 92 grains whose list is made anew as its grains move."""
    return load_scene("bed").replace(
        **{
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "12 D",
            "arrangement.height": "11 D",
            "effects.drag": None,
            "pairs": {"method": "verlet-list", "cut_off": f"{radius} D", "skin": "0.5 D"},
        }
    )


MANY = 100_000


def _many() -> Scene:
    """The packaged bed with 1e5 grains at the same packing, by the mesh."""
    scale = (MANY / 368.0) ** 0.5
    return load_scene("bed").replace(
        **{
            "grains.count": MANY,
            "cell.width": f"{60.0 * scale} D",
            "piston.height": f"{20.0 * scale} D",
            "arrangement.height": f"{20.0 * scale - 1.0} D",
            "pairs.method": "mesh",
            "output": {"scalars": 1e-4, "frames": 1e-3},
        }
    )


def sum_cases() -> tuple[HardCase, ...]:
    """Hard cases of lists and of the far field."""
    lists = tuple(
        HardCase(
            f"list of pairs within {radius} D",
            "the list takes pairs in and leaves others out as the bed moves [D, 5.2]",
            partial(_with_list, radius), ledger, LEDGER, FAIR, 0.05, 1.0,
            errors=("EnergyError",), may_degrade=True,
        )
        for radius in (6.26, 7.26)
    )  # fmt: skip
    return (
        *lists,
        HardCase(
            "1e5 grains by the mesh", "the levels of a mesh 270 times as large as a small bed's",
            _many, ledger, LEDGER, FAIR, 2e-4, 2e-3,
        ),
        HardCase(
            "fast grain across a skin in a step",
            "a grain crosses its lists' skin with every step, and the radius of those it passes",
            _flight, missed, "greatest force missed, over the greatest force",
            1e-12, 0.04, 0.04, dt=1e-3,
        ),
        HardCase(
            "far field at longer steps",
            "a damper's far field in impulses every eighth step, as by default",
            lambda: few_grains("damper", **FAR), ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
        HardCase(
            "resonance of the far field's impulses",
            "impulses every 128 steps come more often than not in step with a fast mode",
            lambda: few_grains("bed", **FAR, **{"pairs.far_every": 128, "effects.drag": None,
                                            "output.scalars": 0.02, "output.frames": 0.1}),
            ledger, LEDGER, FAIR, 0.2, 2.0, dt=2.5e-5, may_degrade=True,
        ),
    )  # fmt: skip
