"""Public measurements on beds of repelling magnets, and a scene for each."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from granular import Scene, load_scene, mono_bed
from granular.observables.moduli import dipole_pair_strength, hexagonal_lattice_sum
from research.measured.mixtures import mixture

THESIS = "de Paula (2025)"
"""Source of what is said of an apparatus whose paper could not be read."""


class Measurement(NamedTuple):
    """A measurement, and what is at hand of it."""

    source: str
    doi: str
    read: str  # figures, and the text that they stand in
    not_read: str
    compared: str  # quantity of the scene to hold against it
    scene: Callable[[], Scene]


def discs_in_a_column() -> Scene:
    """Discs of the packaged `magnets` under their weight in a narrow cell, rubbing on its plates."""
    return load_scene("magnets").replace(
        **{
            "name": "column",
            "cell.width": "12 D",
            "piston": None,
            "grains.count": 120,
            "effects.walls.top": "none",
            "effects.friction": True,
            "arrangement.height": "40 D",
            "protocol": [{"name": "pile", "kind": "hold", "duration": "5 s"}],
            "output": {"scalars": "1 ms", "frames": "0.1 s"},
        }
    )


def upright_magnets() -> Scene:
    """Discs of the packaged `magnets` on a level plate, in a triangular lattice of 2.5 D without a rim."""
    return load_scene("magnets").replace(
        **{
            "name": "layer",
            "cell": {"width": "50 D", "height": f"{50 * math.sqrt(0.75)!r} D", "sides": "periodic"},
            "piston": None,
            "grains.count": 400,
            "effects.walls": None,
            "effects.gravity": None,
            "arrangement": {"jitter": 0.0},
            "protocol": [{"name": "rest", "kind": "hold", "duration": "1 s"}],
            "output": {"scalars": "1 ms", "frames": "0.1 s"},
        }
    )


def silo() -> Scene:
    """The packaged bed above an outlet of 10 D in its bottom."""
    return load_scene("bed").replace(
        **{
            "name": "silo",
            "effects.walls.bottom": {"law": "slab", "gap_start": "25 D", "gap_end": "35 D"},
            "protocol.settle.duration": "10 s",
        }
    )


def largest_packing(scene: Scene, height: float) -> float:
    """Packing fraction at which a lattice of dipoles lifts one that lies higher by so much [m].

    A pair has the energy C (1 - 4.5 z^2/r^2)/r^3 at the offset z, so the sum of 9 C z/r^5 is the weight.
    """
    grains = scene.grains
    strength = dipole_pair_strength(grains.magnets_in_species()[0].moment)
    weight = 9.8 * float(grains.masses()[0])
    spacing = (9.0 * strength * height * hexagonal_lattice_sum(5.0) / weight) ** 0.2
    return math.pi / (2.0 * math.sqrt(3.0)) * (grains.species[0].diameter / spacing) ** 2


MEASUREMENTS = (
    Measurement(
        "Tsuchikusa et al., J. Chem. Phys. 158, 214501 (2023), arXiv:2305.07821",
        "10.1063/5.0149803",
        "abstract: the deviation of the cells' areas is largest, and their skewness 0, if half the magnets "
        "are small; then pentagons, hexagons and heptagons are about as many; among equal magnets hexagons "
        f"dominate. {THESIS}: magnets of 5 and 3 mm, compressed up to 110 N",
        "number and thickness of the magnets, size of the cell, values of deviation and skewness",
        "deviation and skewness of the areas of Voronoi cells, fractions of their polygons",
        mixture,
    ),
    Measurement(
        "Modesto et al., Granular Matter (2022)",
        "10.1007/s10035-022-01268-w",
        f"{THESIS}: the force on the piston follows one exponential in compression and another in expansion",
        "force over the packing fraction, mean distance of the magnets",
        "force on the piston over the packing fraction, in a cycle",
        mono_bed,
    ),
    Measurement(
        "Static and dynamic ordering of magnetic repelling particles ..., arXiv:2507.08816 (2025)",
        "10.48550/arXiv.2507.08816",
        "abstract: piles have an angle of repose; the pressure saturates, by friction under magnetic "
        "torques; resistance to compression rises continuously",
        "sizes, angle of repose, pressure over the filling",
        "force on the floor over the number of discs, with the load that tilted discs have on the plates",
        discs_in_a_column,
    ),
    Measurement(
        "Taberlet, Ferrand and Plihon, Phys. Rev. Lett. 120, 264301 (2018)",
        "10.1103/PhysRevLett.120.264301",
        "abstract: at a largest packing fraction magnets pop out of the plane, by fluctuations of their "
        "altitude, as predicted for dipoles",
        "sizes and largest packing fractions",
        "the packing fraction at which the lattice lifts a disc off the plate (`largest_packing`)",
        upright_magnets,
    ),
    Measurement(
        "Reiss et al., Emergent Scientist 2, 3 (2018)",
        "10.1051/emsci/2018003",
        "abstract: the array collapses where forces or torques of irregularities overcome gravity",
        "sizes and critical densities",
        "the packing fraction at which the lattice lifts a disc off the plate (`largest_packing`)",
        upright_magnets,
    ),
    Measurement(
        "Lumay et al., Papers in Physics 7, 070013 (2015)",
        "10.4279/pip.070013",
        "nothing",
        "sizes, outlets and flow rates",
        "grains that leave in a second, over the outlet's width",
        silo,
    ),
)
