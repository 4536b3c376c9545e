"""Hard cases of beds: what pistons do to them, sizes of grains, sums over pairs."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from granular.run.evaluation import evaluate
from granular.run.trajectory import Trajectory
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.hard_cases.hard_case import ErrorMeasure, HardCase, cut_to_few_grains

# Pistons ----------------------------------------------------------------------------------------


def _damper_fall(**changes: Any) -> Scene:
    """Damper's first fall alone, up to any time."""
    return load_scene("damper").replace(
        **{"protocol": [{"kind": "free", "name": "drop", "duration": 60.0}], "output.record": None, **changes}
    )


def _compressed_bed() -> Scene:
    """Bed whose piston descends until the grains' area is more than the cell's."""
    return cut_to_few_grains(
        "bed",
        **{
            "protocol": [
                {"kind": "move", "name": "squeeze", "to": "1.1 D", "duration": 0.5},
                {"kind": "hold", "name": "hold", "duration": 60.0},
            ]
        },
    )


def _piston_inside_bed() -> Scene:
    """De Paula's N = 92, whose piston would start inside the bed [D, 3.3]."""
    return load_scene("bed").replace(
        **{"grains.count": 92, "cell.width": "30 D", "piston.height": "10 D", "arrangement.height": "12 D"}
    )


def _slab_walls(**bottom: Any) -> Scene:
    """Finite magnetic slabs as bottom and piston."""
    walls = {"left": {}, "right": {}, "bottom": {"law": "slab", **bottom}, "top": {"law": "slab"}}
    return cut_to_few_grains("bed", **{"effects.walls": walls})


def piston_cases() -> tuple[HardCase, ...]:
    """Return the hard cases of what a piston does to a bed."""
    gap = {"gap_start": "5 D", "gap_end": "10 D"}
    rubbing: dict[str, Any] = {"effects.drag": None, "effects.friction": {}}
    return (
        HardCase(
            "full-height drop",
            "the piston falls 55 D before it meets the bed",
            lambda: _damper_fall(**{"piston.height": "75 D"}),
            0.3,
            3.0,
            limit=1e-5,
        ),
        HardCase(
            "100 kg piston",
            "thirteen times the damper's mass falls on the bed",
            lambda: _damper_fall(**{"piston.mass": 100.0}),
            0.15,
            3.0,
        ),
        HardCase(
            "piston inside the bed",
            "de Paula's N = 92 [D, 3.3]",
            _piston_inside_bed,
            0.05,
            0.2,
            errors=("SceneError",),
        ),
        HardCase(
            "packing above 1",
            "the grains' area is more than the cell's, without contact",
            _compressed_bed,
            0.55,
            2.0,
        ),
        HardCase(
            "slabs under the bed", "a finite magnetic slab as the bottom, another as the piston", _slab_walls
        ),
        HardCase(
            "slabs under the bed, with a gap", "grains flow out between two slabs", lambda: _slab_walls(**gap)
        ),
        HardCase(
            "slabs with friction and a gap",
            "grains rub on their way out between two slabs",
            lambda: _slab_walls(**gap).replace(**rubbing),
        ),
    )


# Sizes ------------------------------------------------------------------------------------------


def _bed_of_several_sizes(**fractions: tuple[str, float]) -> Scene:
    """Bed of several species: diameter and fraction of each, by its name."""
    species = [
        {"name": name, "diameter": diameter, "share": fraction}
        for name, (diameter, fraction) in fractions.items()
    ]
    return cut_to_few_grains("bed", **{"grains.species": species, "effects.drag": None})


def size_cases() -> tuple[HardCase, ...]:
    """Hard cases of grains of very different sizes."""
    return (
        HardCase(
            "aspect ratio 0.1",
            "half of the grains are a tenth as wide [D, 4.1]",
            lambda: _bed_of_several_sizes(big=("6 mm", 0.5), small=("0.6 mm", 0.5)),
        ),
        HardCase(
            "three species of ratio 10",
            "the widest grains are ten times as wide as the narrowest",
            lambda: _bed_of_several_sizes(big=("6 mm", 0.4), middle=("1.9 mm", 0.3), small=("0.6 mm", 0.3)),
        ),
    )


# Sums over pairs --------------------------------------------------------------------------------


def greatest_missing_force(run: Trajectory) -> float:
    """Greatest force on a grain that a frame lacks, against lists made for that frame alone."""
    data, worst = run.dataset, 0.0
    for value, height, saved in zip(
        data["position"].values, data["frame_height"].values, data["force"].values, strict=True
    ):
        force = evaluate(run.scene, value, piston_height=float(height)).force
        worst = max(worst, float(np.abs(force - saved).max() / np.abs(force).max()))
    return worst


FAR = {"pairs.method": "mesh", "pairs.cut_off": "3 D"}
"""A far field that matters in a bed of 23 grains."""


def _fast_grain_scene() -> Scene:
    """Grain at 5 m/s, 0.8 D in a step of 1 ms, flies past two rows of slow ones."""
    rows = [[f"{x} D", f"{y} D"] for y in (8, 30) for x in range(6, 60, 6)]
    return cut_to_few_grains(
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


def _bed_with_pair_list(radius: float) -> Scene:
    """Bed of 92 grains whose list is made anew as its grains move."""
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


def _bed_of_1e5_grains() -> Scene:
    """Return the packaged bed with 1e5 grains at the same packing, by the mesh."""
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


def pair_sum_cases() -> tuple[HardCase, ...]:
    """Hard cases of sums over pairs: lists of pairs and the far field."""
    lists = tuple(
        HardCase(
            f"list of pairs within {radius} D",
            "the list takes pairs in and leaves others out as the bed moves [D, 5.2]",
            partial(_bed_with_pair_list, radius),
            errors=("EnergyError",),
            may_degrade=True,
        )
        for radius in (6.26, 7.26)
    )
    return (
        *lists,
        HardCase(
            "1e5 grains by the mesh",
            "the levels of a mesh 270 times as large as a small bed's",
            _bed_of_1e5_grains,
            2e-4,
            2e-3,
        ),
        HardCase(
            "fast grain across a skin in a step",
            "a grain crosses its lists' skin with every step, and the radius of those it passes",
            _fast_grain_scene,
            0.04,
            0.04,
            ErrorMeasure("greatest force missed, over the greatest force", greatest_missing_force),
            1e-12,
            dt=1e-3,
        ),
        HardCase(
            "far field at longer steps",
            "a damper's far field in impulses every eighth step, as by default",
            lambda: cut_to_few_grains("damper", **FAR),
        ),
        HardCase(
            "resonance of the far field's impulses",
            "impulses every 128 steps come more often than not in step with a fast mode",
            lambda: cut_to_few_grains(
                "bed",
                **FAR,
                **{
                    "pairs.far_every": 128,
                    "effects.drag": None,
                    "output.scalars": 0.02,
                    "output.frames": 0.1,
                },
            ),
            0.2,
            2.0,
            dt=2.5e-5,
            may_degrade=True,
        ),
    )
