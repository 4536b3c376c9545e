"""Digests of runs and a table of fits, which a mere reorganisation of code must not change.

``python -m tests.regression.digests`` computes them and writes tests/data/digests.json, with processor
and library versions. On another processor rounding differs, for instance by 1e-14 of the positions.
Then only the stored rms values are compared.
"""

import hashlib
import json
import platform
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite.binding import get_host_cpu_name

from granular import Scene, load_scene, simulate
from reduced_models import fit
from reduced_models.laws import LAWS
from tests.reduced_models.conftest import Made

FILE = Path(__file__).parents[1] / "data" / "digests.json"
SECONDS = 0.2
SCENES = ("bed", "damper", "damper-source", "machine", "single-particle")
PARTED = "bed of 1472"
"""A bed large enough for pair sums on several threads."""
WAYS: dict[str, dict[str, Any]] = {
    "direct": {"pairs.method": "direct"},
    "mesh": {"pairs.method": "mesh"},
    "friction": {"pairs.method": "direct", "effects.friction": {}},
}
QUANTITIES = ("position", "velocity", "piston_height")
LIBRARIES = ("numba", "llvmlite", "numpy", "scipy", "jax", "jaxlib", "diffrax")


def surroundings() -> dict[str, str]:
    """Return processor, system and library versions, on which the last digits may depend."""
    name = numba.config.CPU_NAME or get_host_cpu_name()
    processor = f"{platform.system()} {platform.machine()} {name}"
    return {"processor": processor} | {one: version(one) for one in LIBRARIES}


def cases() -> Iterator[tuple[str, str]]:
    """Return each scene with each pair sum, and with friction; the mesh requires a closed cell."""
    for name in (*SCENES, PARTED):
        for way in WAYS:
            if (name, way) != ("single-particle", "mesh"):
                yield name, way


def scene_of(name: str, way: str) -> Scene:
    if name != PARTED:
        return load_scene(name).replace(**WAYS[way])
    larger = {
        "grains.count": 1472,
        "cell.width": "120 D",
        "piston.height": "40 D",
        "arrangement.height": "38 D",
    }
    return load_scene("bed").replace(**larger, **WAYS[way])


def run_of(name: str, way: str, threads: int) -> dict[str, dict[str, Any]]:
    """Return SHA-256 and rms of each recorded quantity, in SI units."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = scene_of(name, way)
        data = simulate(scene, t_end=SECONDS, threads=threads, progress=False).dataset
    found = {}
    for quantity in QUANTITIES:
        if quantity in data:
            values = np.ascontiguousarray(data[quantity].values, dtype="<f8")
            digest = hashlib.sha256(repr(values.shape).encode() + values.tobytes()).hexdigest()
            found[quantity] = {"sha256": digest, "rms": float(np.sqrt(np.mean(values**2)))}
    return found


def fit_of(law: str) -> dict[str, list[float]]:
    """Return value and confidence interval of each parameter, from a synthetic record with 1 % noise."""
    model = fit(Made()(law, seed=1), law)
    return {name: [value, *model.intervals[name]] for name, value in model.parameters.items()}


def write() -> None:
    """Compute all digests and fits, and write the file."""
    runs = {}
    for name, way in cases():
        runs[f"{name}, {way}"] = run_of(name, way, 1)
        print(name, way, flush=True)
    fits = {}
    for law in LAWS:
        fits[law] = fit_of(law)
        print(law, fits[law], flush=True)
    integer = {"surroundings": surroundings(), "runs": runs, "fits": fits}
    FILE.write_text(json.dumps(integer, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write()
