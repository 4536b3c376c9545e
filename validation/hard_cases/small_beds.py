"""The small beds that many hard cases start from."""

from __future__ import annotations

from typing import Any

from granular.scene.loading import load_scene
from granular.scene.scene import Scene


def few_grains(name: str, **changes: Any) -> Scene:
    """A packaged scene cut down to 23 grains."""
    size = {
        "grains.count": 23,
        "cell.width": "15 D",
        "piston.height": "6 D",
        "arrangement.height": "5.5 D",
    }
    if name == "damper":
        size["piston.mass"] = 1.0
    return load_scene(name).replace(**{**size, **changes})
