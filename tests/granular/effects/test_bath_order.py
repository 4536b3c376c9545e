"""How far a step of the bath is from the right temperature: second order."""

from __future__ import annotations

import math

import numpy as np
import pytest

from granular import Scene, simulate
from granular.schema.natural_units import Scales

WELLS = 0.02
"""From well to well [m]."""
DEPTH = 1e-4
"""a of the energy a (2 - cos kx - cos ky) [J]."""
WARM = 2.0
"""Temperature of the bath, over a: far from harmonic."""
RATE = 0.2
"""Of the bath, over the frequency of small swings."""


def wells(columns: int, seed: int) -> tuple[Scene, float]:
    """A grain in each of many wells, and the frequency of small swings [1/s]."""
    extent = (columns + 1) * WELLS
    scene = Scene.from_plain(
        {
            "grains": {"count": columns**2, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": extent},
            "effects": {
                "field": [
                    {
                        "energy": "a*(2 - cos(k*x) - cos(k*y))",
                        "a": f"{DEPTH} J",
                        "k": f"{2.0 * math.pi / WELLS!r} 1/m",
                    }
                ]
            },
            "arrangement": {"height": extent, "jitter": 0.0},
            "protocol": [{"kind": "hold", "name": "rest"}],
        }
    )
    frequency = 2.0 * math.pi / WELLS * math.sqrt(DEPTH / Scales.from_grains(scene.grains).mass)
    bath = {"temperature": WARM * DEPTH, "rate": RATE * frequency, "seed": seed}
    return scene.replace(**{"effects.bath": bath}), frequency


def temperatures(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of frames (f, n) of k x: sums of |grad U|^2 and of the Laplacian, over a k^2."""
    return (np.sin(angles) ** 2).sum(axis=1), np.cos(angles).sum(axis=1)


def too_warm(squares: np.ndarray, bends: np.ndarray) -> tuple[float, float]:
    """Error of the configurational temperature, and its own standard error, by blocks."""
    blocks = [
        one.sum() / other.sum()
        for one, other in zip(np.array_split(squares, 20), np.array_split(bends, 20), strict=True)
    ]
    error = float(np.std(blocks) / math.sqrt(19.0))
    return squares.sum() / bends.sum() / WARM - 1.0, error / WARM


def by_the_bath(step: float) -> tuple[float, float]:
    """Of the engine; ``step`` in units of the inverse frequency."""
    squares, bends = [], []
    for seed in range(1, 11):
        scene, frequency = wells(160, seed)
        dt = step / frequency
        apart = max(1, round(1.5 / step)) * dt
        scene = scene.replace(**{"output": {"scalars": apart, "frames": apart}})
        run = simulate(scene, t_end=(20 + 800) * apart, dt=dt, progress=False, threads=1)
        places = run.dataset["position"].values[21:].reshape(800, -1)
        for kept, found in zip((squares, bends), temperatures(2.0 * math.pi / WELLS * places), strict=True):
            kept.append(found)
    return too_warm(np.concatenate(squares), np.concatenate(bends))


def slope(steps: tuple[float, ...], found: list[tuple[float, float]]) -> tuple[float, float]:
    """Slope of ln|error| over ln step, and its standard error."""
    errors, sigmas = np.abs(found).T
    x, weights = np.log(steps), (errors / sigmas) ** 2
    middle = np.average(x, weights=weights)
    spread = (weights * (x - middle) ** 2).sum()
    value = (weights * (x - middle) * np.log(errors)).sum() / spread
    return float(value), float(1.0 / math.sqrt(spread))


@pytest.mark.long  # quick: the generator's numbers, and a run that goes on
def test_configurational_temperature_is_wrong_to_second_order() -> None:
    """In an anharmonic field, where the splitting is not exact."""
    steps = (0.14, 0.23, 0.38)
    found = [by_the_bath(step) for step in steps]
    value, sigma = slope(steps, found)
    print("bath", found, value, sigma)
    assert sigma < 0.07
    assert value == pytest.approx(2.0, abs=0.2)
    assert all(error > 0.0 for error, _ in found)
