"""Pair laws of one's own with a tail as r^-3 has it: by each sum, with images, species and scatter.

The law is a Yukawa repulsion and c/r^3, against sums written out pair by pair.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numba
import numpy as np
import pytest

from granular import Scene, effect, evaluate, quantity
from tests.granular.pairs.test_periodic import ewald_energy
from tests.plain_python.brute_force import Bed, Law, Reach, Sums, bed_of, dipoles, sum_pairs
from tests.plain_python.test_drawn_scenes import (
    CHOICES,
    METHODS,
    MM,
    SPACING,
    SPECIES,
    Drawn,
    draw_places,
    reach_of,
    rms,
)

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

A, LENGTH, C, WIDE = 1.0, 0.5 * MM, 1e-9, 2 * MM
"""[J m], [m], [J m^3], [m]: the tail is that of dipoles, and the rest, a quarter of it where big grains
touch, is spent at the cut-off. The last is the length of the law by masses."""
CLOSE = 1e-9
"""Error of a tabled law by direct sum and cut-off, over the rms of a grain's sum of sizes."""


@effect
class Tailed:
    """A Yukawa repulsion with a tail of dipoles."""

    a: float = quantity("J*m", default=A)
    length: float = quantity("m", default=LENGTH)
    c: float = quantity("J*m^3", default=C)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        return first.moment * second.moment * (p.a * math.exp(-r / p.length) / r + p.c / r**3)

    @staticmethod
    def tail(p: Any, first: Any, second: Any) -> Any:
        return first.moment * second.moment * p.c


@effect
class ByMass:
    """A screened repulsion by the masses of both grains, which ends at a distance."""

    a: float = quantity("J*m/kg", default=0.3)
    length: float = quantity("m", default=WIDE)
    end: float = quantity("m", default=25 * MM)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        rest = max(p.end - r, 0.0) / p.end
        return p.a * (first.mass + second.mass) * math.exp(-r / p.length) / r * rest**4

    @staticmethod
    def reach(p: Any) -> Any:
        return p.end


FORMULA = {
    "energy": "q1*q2*(a*exp(-r/l)/r + c/r**3)",
    "tail": "q1*q2*c",
    "a": f"{A} J*m",
    "l": f"{LENGTH} m",
    "c": f"{C} J*m^3",
}
WRITTEN: dict[str, dict[str, Any]] = {
    "formula": {"pair_law": [FORMULA]},
    "class": {"tailed": True},
    "by mass": {"by_mass": True},
}
BEDS = (
    frozenset({"one species", "alike"}),
    frozenset({"two species", "alike"}),
    frozenset({"two species", "scatter"}),
    frozenset({"three species", "scatter"}),
)
CASES = [
    (written, alone, Drawn(bed | {method, sides, "dipoles", "contact"}, number))
    for number, (written, alone, bed, method, sides) in enumerate(
        itertools.product(WRITTEN, (True, False), BEDS, ("direct", "cut-off", "mesh"), CHOICES["sides"])
    )
    if number % 5 == 0 or bed == BEDS[2]
]


def yukawa(bed: Bed) -> Law:
    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        energy = bed.ratios[i] * bed.ratios[j] * A * np.exp(-r / LENGTH) / r
        return energy, energy * (1.0 / r + 1.0 / LENGTH)

    return law


def tail_alone(bed: Bed) -> Law:
    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        strength = C * bed.ratios[i] * bed.ratios[j]
        return strength / r**3, 3.0 * strength / r**4

    return law


def by_mass(bed: Bed) -> Law:
    def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rest = np.maximum(25 * MM - r, 0.0) / (25 * MM)
        energy = 0.3 * (bed.masses[i] + bed.masses[j]) * np.exp(-r / WIDE) / r
        return energy * rest**4, energy * ((1.0 / r + 1.0 / WIDE) * rest**4 + 4.0 * rest**3 / (25 * MM))

    return law


@dataclasses.dataclass(frozen=True)
class Tail:
    """A scene, its bed, and what is to be found."""

    scene: Scene
    bed: Bed
    known: tuple[Sums, ...]


def make_tail(written: str, alone: bool, drawn: Drawn) -> Tail:
    """Make a bed of such a law; overlapping grains are drawn as if there were a contact."""
    random = np.random.default_rng([11, drawn.seed])
    closed = "closed" in drawn.features
    columns, rows = (8, 5) if closed else (10, 11)
    width, height = columns * SPACING, rows * SPACING
    species = SPECIES[: 1 + CHOICES["species"].index(drawn.chosen("species"))]
    effects = WRITTEN[written] | ({} if alone else {"dipole": True})
    if closed:
        effects |= {"walls": True}
    kept = Drawn(drawn.features - {"contact"}, drawn.seed)
    plain: dict[str, Any] = {
        "grains": {
            "count": columns * rows,
            "species": [one | {"share": 1.0 / len(species)} for one in species],
            "spread": 0.1 if "scatter" in drawn.features else 0.0,
        },
        "cell": {"width": width} | ({} if closed else {"sides": "periodic", "height": height}),
        "pairs": METHODS[drawn.chosen("sum")],
        "effects": effects,
        "protocol": [{"kind": "hold", "name": "rest", "duration": 1.0}],
    } | ({"piston": {"height": height}} if closed else {})
    grains = Scene.from_plain(plain | {"effects": {}, "pairs": {}, "protocol": []}).grains
    places = draw_places(kept, random, grains.diameters(), columns)
    scene = Scene.from_plain(plain | {"arrangement": {"positions": places.tolist()}})
    bed = bed_of(scene, places)
    reach = reach_of(kept, bed)
    if written == "by mass":
        known = [sum_pairs(bed, by_mass(bed), Reach(25 * MM))]
    else:  # the method sums the tail; what is short has an end of its own
        known = [sum_pairs(bed, yukawa(bed)), sum_tail(bed, tail_alone(bed), reach, C)]
    if not alone:
        known.append(sum_tail(bed, dipoles(bed), reach, 0.25 * bed.unit * bed.size**4))
    return Tail(scene, bed, tuple(known))


def sum_tail(bed: Bed, law: Law, reach: Reach, coefficient: float) -> Sums:
    """Sum a law as r^-3 with that coefficient [J m^3]; the energy of all images by Ewald's sum."""
    result = sum_pairs(bed, law, reach)
    if reach.images:
        assert bed.periods is not None
        unit = 4.0 * coefficient / bed.size**3
        result.energy = unit * ewald_energy(bed.places / bed.size, bed.periods / bed.size, bed.ratios)
    return result


def check_tail(written: str, alone: bool, drawn: Drawn) -> None:
    """Check forces, energy, momentum and the slope."""
    tail = make_tail(written, alone, drawn)
    scene, bed = tail.scene, tail.bed
    meshed = "mesh" in drawn.features
    error = scene.pairs.tolerance if meshed else CLOSE
    found = evaluate(scene, bed.places)
    force, energy = found.force, found.potential_energy
    if bed.piston is not None:
        rest = evaluate(scene.replace(effects={"walls": True}), bed.places)
        force, energy = force - rest.force, energy - rest.potential_energy
    size = rms(sum(one.sizes for one in tail.known))
    np.testing.assert_allclose(force, sum(one.force for one in tail.known), rtol=0.0, atol=error * size)
    assert energy == pytest.approx(math.fsum(one.energy for one in tail.known), rel=error)
    assert np.abs(force.sum(axis=0)).max() < (error if meshed else 1e-12) * size * len(force)
    way = np.random.default_rng(3).normal(size=bed.places.shape)
    h = 2e-5 * bed.size / np.abs(way).max()
    near = [evaluate(scene, bed.places + k * h * way).potential_energy for k in (-2, -1, 1, 2)]
    slope = (near[0] - 8.0 * near[1] + 8.0 * near[2] - near[3]) / (12.0 * h)
    off = (1e-4 if meshed else 1e-7) * float(np.abs(found.force * way).sum())
    assert float((found.force * way).sum()) == pytest.approx(-slope, rel=0.0, abs=off)


def label(value: Any) -> str:
    return (
        {True: "alone", False: "with dipoles"}.get(value, str(value))
        if isinstance(value, bool)
        else str(value)
    )


def every(number: int) -> list[Any]:
    """All cases; those between every so many take long together."""
    return [pytest.param(*case, marks=pytest.mark.long if k % number else ()) for k, case in enumerate(CASES)]


@pytest.mark.parametrize(
    ("written", "alone", "drawn"), every(3 if numba.config.DISABLE_JIT else len(CASES)), ids=label
)
def test_an_own_law_with_a_tail_is_summed_as_written_out(written: str, alone: bool, drawn: Drawn) -> None:
    check_tail(written, alone, drawn)
