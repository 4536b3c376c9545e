"""Pressure of the lattice of discs: against sums pair by pair, a simulated crystal, and dipoles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, damper, simulate
from granular.effects.dipole import discs_unless_dipoles
from granular.pairs.disc_law import disc_energy_and_force
from granular.schema.apparatus import Grains
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from reduced_models.falls.predicted_law import POWER, lattice_pressure, lattice_under_pressure

UNLIKE = [
    {"name": "big", "diameter": 0.006, "share": 0.6},
    {"name": "small", "diameter": 0.0045, "share": 0.4, "thickness": 0.002},
]
ROWS = 26


def discs(**changes: Any) -> Grains:
    return damper().replace(**{"grains.magnets": "cylinders", **changes}).grains


def density(spacing: float) -> float:
    return 2.0 / math.sqrt(3.0) / spacing**2


def summed_pressure(grains: Grains, spacing: float) -> float:
    """Virial of all places within 25 spacings, and beyond them of a continuum of dipoles."""
    cut = 25.0
    i, j = np.mgrid[-40:41, -40:41]
    r = spacing * np.sqrt((i * i + i * j + j * j).astype(float).ravel())
    r = r[(r > 0.0) & (r <= cut * spacing)]
    known, shares, moments = (
        discs_unless_dipoles(grains, 0.006),
        grains.species_fractions(),
        grains.moment_ratios(),
    )
    beyond = 3.0 * density(spacing) * 2.0 * math.pi / (cut * spacing)
    total = 0.0
    for k, m in np.ndindex(len(known), len(known)):
        virial = float((r * disc_energy_and_force(r, known[k], known[m])[1]).sum()) + beyond
        total += shares[k] * shares[m] * moments[k] * moments[m] * virial
    return density(spacing) / 16.0 * total


@pytest.mark.parametrize("changes", [{}, {"grains.species": UNLIKE}])
@pytest.mark.parametrize("spacing", [1.01, 1.37])
def test_pressure_is_the_virial_of_the_pair_law(changes: dict[str, Any], spacing: float) -> None:
    grains = discs(**changes)
    found = lattice_pressure(grains, density(spacing))
    assert found == pytest.approx(summed_pressure(grains, spacing), rel=2e-3)  # the edge of the sum


def test_far_apart_discs_are_dipoles() -> None:
    """The excess over dipoles falls with the square of the spacing: (5/2) b S5/S3 of it."""
    excess = [
        lattice_pressure(discs(), density(a)) / lattice_pressure(damper().grains, density(a)) - 1.0
        for a in (10.0, 20.0)
    ]
    assert excess[0] / excess[1] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("magnets", ["dipoles", "cylinders"])
def test_lattice_under_a_pressure_has_it(magnets: str) -> None:
    grains = damper().replace(**{"grains.magnets": magnets}).grains
    lattice = lattice_under_pressure(grains, 0.5)
    assert lattice_pressure(grains, lattice.density) == pytest.approx(0.5, rel=1e-6)
    powers = lattice.power, lattice_under_pressure(grains, 5e-6).power
    assert powers[1] == pytest.approx(POWER, abs=3e-3)
    assert lattice.relative_shear_modulus == pytest.approx((lattice.power / 2.0 - 1.0) / 0.25)
    assert (powers[0] > 2.65) == (magnets == "cylinders")


def test_pistons_that_press_discs_together_are_refused() -> None:
    with pytest.raises(InputError, match=r"lets these discs touch.*less piston\.mass"):
        lattice_under_pressure(discs(), 5.0)


def crystal(spacing: float) -> Scene:
    """A periodic cell that holds shaken hexagonal rows of discs."""
    a = spacing * 0.006
    rows, columns = np.divmod(np.arange(ROWS * ROWS), ROWS)
    places = a * np.stack([columns + 0.25 + 0.5 * (rows % 2), math.sqrt(0.75) * (rows + 0.5)], axis=1)
    places += np.random.default_rng(5).uniform(-0.02, 0.02, places.shape) * a
    return Scene.from_plain(
        {
            "name": "crystal",
            "grains": {
                "count": ROWS * ROWS,
                "species": [{"name": "disc", "diameter": "6 mm"}],
                "magnets": "cylinders",
            },
            "cell": {"width": ROWS * a, "height": ROWS * math.sqrt(0.75) * a, "sides": "periodic"},
            "effects": {"dipole": {}, "drag": {"coefficient": "0.5 kg/s"}},
            "pairs": {"method": "mesh", "tolerance": 1e-4},
            "arrangement": {"positions": places.tolist()},
            "protocol": [{"name": "rest", "kind": "hold", "duration": 0.2}],
        }
    )


def relaxed_energy(spacing: float) -> tuple[float, float]:
    """Energy [J] of a crystal that came to rest, and the area of its cell [m^2]."""
    scene = crystal(spacing)
    assert scene.cell.height is not None
    energy = simulate(scene, progress=False).dataset["pair_energy"].values[-1]
    return float(energy), scene.cell.width * scene.cell.height


@pytest.mark.long
@pytest.mark.parametrize("spacing", [1.08, 1.37])
def test_pressure_is_that_of_a_simulated_crystal(spacing: float) -> None:
    """Minus the slope of its energy by the area, within 0.1 %."""
    (low, small), (high, large) = (relaxed_energy(spacing * f) for f in (0.995, 1.005))
    simulated = (low - high) / (large - small)
    scales = Scales.from_grains(discs())
    expected = lattice_pressure(discs(), density(spacing)) * scales.force / scales.length
    assert simulated == pytest.approx(expected, rel=1e-3)
