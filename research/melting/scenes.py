"""A layer of dipoles in a periodic cell with a heat bath, at a given interaction parameter."""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.observables.moduli import dipole_pair_strength, lattice_spacing
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales

SPACING = 2.4
"""Spacing of the lattice, in diameters; for an energy r^-3 it only sets the units."""

RATE = 0.1
"""Rate of the bath, in inverse units of time: slow enough for sound to travel through the cell."""

STEP = "auto*3"
"""Time step: 0.43 over the highest frequency. Its error shows in the measured temperatures."""

FRAMES = 0.5
"""Interval between frames [s]: 27 units of time."""


class Layer(NamedTuple):
    """A scene, and its units.

    Attributes
    ----------
    scene : Scene
    gamma : float
        C (pi rho)^(3/2)/T.
    temperature : float
        k_B T [J].
    density : float
        rho [1/m^2].
    strength : float
        C of the energy C/r^3 of a pair [J m^3].
    time : float
        Unit of time, sqrt(m/(C rho^(5/2))) [s].
    """

    scene: Scene
    gamma: float
    temperature: float
    density: float
    strength: float
    time: float

    @property
    def spacing(self) -> float:
        """Spacing of the hexagonal lattice of this density [m]."""
        return lattice_spacing(self.density)


def make_layer(gamma: float, columns: int, seed: int = 1) -> Layer:
    """Make a hexagonal crystal with equal numbers of columns and rows, at rest, with a heat bath.

    Parameters
    ----------
    gamma : float
        Interaction parameter C (pi rho)^(3/2)/T, which determines the temperature of the bath.
    columns : int
        Number of columns, even.
    seed : int
        Of the bath.
    """
    diameter = 0.006
    a = SPACING * diameter
    width, height = columns * a, columns * a * math.sqrt(0.75)
    still = Scene.from_plain(
        {
            "name": f"layer at Gamma = {gamma:g}",
            "grains": {"count": columns**2, "species": [{"diameter": diameter}]},
            "cell": {"width": width, "height": height, "sides": "periodic"},
            "effects": {"dipole": True},
            "pairs": {"method": "mesh"},
            "arrangement": {"jitter": 0.0},
            "protocol": [{"kind": "hold", "name": "rest"}],
            "output": {"scalars": FRAMES / 10.0, "frames": FRAMES},
        }
    )
    scales = Scales.from_grains(still.grains)
    strength = dipole_pair_strength(scales.current * scales.length**2)
    density = columns**2 / (width * height)
    temperature = strength * (math.pi * density) ** 1.5 / gamma
    time = math.sqrt(scales.mass / (strength * density**2.5))
    bath = {"temperature": temperature, "rate": RATE / time, "seed": seed}
    scene = still.replace(**{"effects.bath": bath})
    return Layer(scene, gamma, temperature, density, strength, time)
