"""Hard cases of pistons: falls, weights, squeezed beds, slabs."""

from __future__ import annotations

from typing import Any

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.hard_cases.measures import FAIR, LEDGER, ledger
from validation.hard_cases.small_beds import few_grains
from validation.outcomes import HardCase


def _drop(**changes: Any) -> Scene:
    """The damper's first fall alone, up to any time."""
    return load_scene("damper").replace(
        **{
            "protocol": [{"kind": "free", "name": "drop", "duration": 60.0}],
            "output.record": None,
            **changes,
        }
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


def _inside() -> Scene:
    """De Paula's N = 92, whose piston would start inside the bed [D, 3.3]."""
    return load_scene("bed").replace(
        **{"grains.count": 92, "cell.width": "30 D", "piston.height": "10 D",
           "arrangement.height": "12 D"}
    )  # fmt: skip


def _slabs(**bottom: Any) -> Scene:
    """Finite magnetic slabs as bottom and piston."""
    walls = {"left": {}, "right": {}, "bottom": {"law": "slab", **bottom}, "top": {"law": "slab"}}
    return few_grains("bed", **{"effects.walls": walls})


def piston_cases() -> tuple[HardCase, ...]:
    """What a piston may do to a bed."""
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
            "piston inside the bed", "de Paula's N = 92 [D, 3.3]",
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
        HardCase(
            "slabs with friction and a gap", "grains rub on their way out between two slabs",
            lambda: _slabs(gap_start="5 D", gap_end="10 D").replace(
                **{"effects.drag": None, "effects.friction": {}}
            ),
            ledger, LEDGER, FAIR, 0.05, 1.0,
        ),
    )  # fmt: skip
