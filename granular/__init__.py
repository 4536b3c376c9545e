"""Simulation of beds of repelling magnets between two glass plates, and of the piston on them.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()
"""

import lazy_loader

from granular.shared.missing import with_advice
from granular.shared.moved import forward

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_advice(__getattr__)

# What stood under these names before.
forward(
    "granular",
    {
        "arrangement": "scene.arrangement",
        "beds": "scene.beds",
        "scales": "scene.scales",
        "schema": "scene.schema",
        "units": "scene.units",
        "drive": "run.drive",
        "evaluation": "run.evaluation",
        "progress": "run.progress",
        "record": "run.record",
        "recorder": "run.recorder",
        "simulation": "run.simulation",
        "store": "run.store",
        "summary": "run.summary",
        "trajectory": "run.trajectory",
        "variables": "run.variables",
        "console": "shared.console",
        "errors": "shared.errors",
        "html": "shared.html",
        "plotting": "shared.plotting",
        "tables": "readers.parquet",
    },
)
