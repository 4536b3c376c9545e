"""Beds whose steps the benchmark times."""

from __future__ import annotations

import math
from typing import Any

from granular.pairs.pair_sum_settings import METHODS
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene

PAIR_METHODS = tuple(name for name in METHODS if name != "auto")
"""All methods of summing pairs that a scene can select."""


def bed_of(count: int, changes: dict[str, Any]) -> Scene:
    """Return the packaged bed with ``count`` grains, scaled to the same packing."""
    scale = math.sqrt(count / 368.0)
    shape = {
        "grains.count": count,
        "cell.width": f"{60.0 * scale} D",
        "piston.height": f"{20.0 * scale} D",
        "arrangement.height": f"{20.0 * scale - 1.0} D",
    }
    return load_scene("bed").replace(**shape, **changes)
