"""Scenes that the report measures next to those of the package."""

from __future__ import annotations

import math

import numpy as np

from granular.scene.loading import load_scene
from granular.scene.scene import Scene


def compression_scene() -> Scene:
    """Quarter of de Paula's bed with dry friction, compressed at 33 mm/s [D, 2.3.3]."""
    return load_scene("bed").replace(
        **{
            "name": "compression",
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "45 D",
            "arrangement.height": "40 D",
            "effects.drag": None,
            "effects.friction": {},
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "10 D", "speed": "33 mm/s"},
            ],
            "output.scalars": 0.01,
            "output.frames": 1.0,
        }
    )


def frictionless_bed() -> Scene:
    """Return the packaged bed without drag: it keeps its energy."""
    return load_scene("bed").replace(**{"name": "bed without friction", "effects.drag": None})


def disturbed_lattice(count: int) -> Scene:
    """Scene of a disturbed hexagonal lattice at the packing of the packaged bed."""
    scale = math.sqrt(count / 368.0)
    width, height = 60.0 * scale, 20.0 * scale
    apart = math.sqrt(2.0 / math.sqrt(3.0) * width * height / count)
    rows = round(height / (apart * math.sqrt(0.75)))
    fractions = [count // rows + (row < count % rows) for row in range(rows)]
    indices = np.array(
        [
            ((i + 0.5 + 0.25 * (-1) ** row) * width / many, (row + 0.5) * height / rows)
            for row, many in enumerate(fractions)
            for i in range(many)
        ]
    )
    indices += 0.05 * apart * np.random.default_rng(1).standard_normal(indices.shape)
    indices = np.clip(indices, 0.6, np.array([width, height]) - 0.6)
    scene = load_scene("bed")
    diameter = scene.grains.species[0].diameter
    return scene.replace(
        **{
            "grains.count": count,
            "cell.width": width * diameter,
            "piston.height": height * diameter,
            "arrangement": {"positions": (diameter * indices).tolist(), "speed": 0.0},
            "output": {"scalars": 0.01, "frames": 1.0},
        }
    )
