"""Magnetic moments of commercial magnets, and their scene keys, compared with hand calculation."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.special import ellipe, ellipk

from granular import Scene, load_scene, scene_text
from granular.observables.moduli import hexagonal_lattice_sum
from granular.pairs.disc_law import Disc, disc_energy_and_force
from granular.parts.magnets import GRADES, LATTICE_SUM, demagnetising_factor
from granular.schema import Scales
from granular.shared.errors import InputError

MU0 = 4e-7 * math.pi


def moment(scene: Scene) -> float:
    scales = Scales.from_grains(scene.grains)
    return float(scales.current * scales.length**2)


def damper(**changes: object) -> Scene:
    return load_scene("damper").replace(**{key.replace("__", "."): value for key, value in changes.items()})


@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.0])
def test_demagnetising_factor_agrees_with_the_energy_of_the_surface_charges(ratio: float) -> None:
    """N = 2 (U(0) - U(h))/(4 pi V), where U(z) is the integral of 1/distance over two discs of radius 1
    at distance z.
    """
    height = 2.0 * ratio

    def potential(z: float) -> float:
        def ring(v: float) -> float:
            # Overlap of two discs a distance v apart, times 1/distance round the ring.
            overlap = 2.0 * math.acos(v / 2.0) - v * math.sqrt(1.0 - v * v / 4.0)
            return 2.0 * math.pi * v * overlap / math.sqrt(v * v + z * z)

        return float(dblquad(lambda v, _: ring(v), 0.0, 1.0, 0.0, 2.0, epsabs=1e-11)[0])

    expected = 2.0 * (potential(0.0) - potential(height)) / (4.0 * math.pi * math.pi * height)
    assert demagnetising_factor(2.0, height) == pytest.approx(expected, rel=1e-6)


def test_demagnetising_factor_of_a_catalogue_disc_agrees_with_tables() -> None:
    """It is 0.4745 = 1 - k. Nagaoka's coefficient k is 0.5255 for a coil twice as wide as long."""
    assert demagnetising_factor(6.0, 3.0) == pytest.approx(1.0 - 0.525510, abs=2e-6)


def test_constant_of_the_hexagonal_lattice_sum_agrees_with_direct_summation() -> None:
    assert hexagonal_lattice_sum() == pytest.approx(LATTICE_SUM, abs=1e-4)


def test_magnetic_moment_of_a_coated_disc_agrees_with_hand_calculation() -> None:
    scene = damper(
        grains__remanence=1.31,
        grains__coating="15 um",
        grains__permeability=1.05,
        grains__spacing="8.25 mm",
        grains__temperature="40 °C",
    )
    d, h = 5.97e-3, 2.97e-3
    volume = math.pi * d**2 * h / 4.0
    k2 = d**2 / (d**2 + h**2)
    k, rest = math.sqrt(k2), 1.0 - k2
    nagaoka = 4 / (3 * math.pi * math.sqrt(rest)) * (rest / k2 * (ellipk(k2) - ellipe(k2)) + ellipe(k2) - k)
    field = 1.0 - nagaoka + 11.034175 * volume / (4.0 * math.pi * 8.25e-3**3)
    expected = 1.31 * (1.0 - 0.0012 * 20.0) * volume / MU0 / (1.0 + 0.05 * field)
    assert moment(scene) == pytest.approx(expected, rel=1e-9)
    assert scene.grains.masses()[0] == load_scene("damper").grains.masses()[0]


def test_coating_and_permeability_reduce_the_moment_of_a_commercial_disc_by_5_5_percent() -> None:
    parts = {"grains.coating": "20 um", "grains.permeability": 1.05, "grains.spacing": "1.375 D"}
    assert moment(damper(**parts)) / moment(damper()) - 1.0 == pytest.approx(-0.055, abs=5e-4)


def test_mean_field_of_a_neighbouring_disc_is_close_to_a_dipole_field() -> None:
    """The mean field in a disc follows from the pair energy.

    At 1.375 D a dipole's field is about 4/5 of it.
    """
    disc = Disc(0.5, 0.5)
    energy = float(disc_energy_and_force(np.array([1.375]), disc, disc)[0][0])
    assert 0.75 < 1.375**-3 / energy < 0.9


def test_measured_moment_replaces_the_remanence() -> None:
    assert moment(damper(grains__moment=0.0812)) == pytest.approx(0.0812, rel=1e-9)
    hot = damper(grains__moment=0.0812, grains__coating="15 um", grains__permeability=1.05)
    assert moment(hot) == pytest.approx(0.0812, rel=1e-9)  # the measurement includes both
    hot = hot.replace(**{"grains.temperature": 70.0})
    assert moment(hot) == pytest.approx(0.0812 * (1.0 - 0.06), rel=1e-9)
    near = hot.replace(**{"grains.spacing": "8.25 mm"})
    assert moment(near) < moment(hot)
    assert "remanence" not in near.to_plain()["grains"]
    assert Scene.from_plain(near.to_plain()) == near
    assert near.replace(**{"grains.remanence": 1.3}).grains.moment is None


def test_magnet_grade_sets_remanence_permeability_and_maximum_temperature() -> None:
    scene = damper(grains__grade="N48")
    assert scene.grains.remanence == pytest.approx(0.5 * (1.37 + 1.42))
    assert scene.grains.permeability == 1.05
    assert scene.replace(**{"grains.grade": "N35"}).grains.remanence == pytest.approx(1.195)
    measured = scene.replace(**{"grains.remanence": 1.4})
    assert (measured.grains.remanence, measured.grains.grade) == (1.4, "N48")
    assert Scene.from_plain(measured.to_plain()) == measured
    with pytest.raises(InputError, match="exceeds 80 °C, the limit of N48"):
        scene.replace(**{"grains.temperature": 90.0})
    assert scene.replace(**{"grains.grade": "N48M", "grains.temperature": 90.0})
    assert all(grade.lowest < grade.remanence < grade.highest for grade in GRADES.values())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"grains.grade": "N99"}, "grains.grade: unknown grade"),
        ({"grains.coating": "2 mm"}, "grains.coating: .* on both sides fills a grain"),
        ({"grains.moment": 0.08, "grains.remanence": 1.2}, "grains.moment: .* remove one of them"),
        ({"grains.permeability": 1.05, "grains.spacing": "5 mm"}, "grains.spacing: .* is below"),
        ({"grains.spacing": "8 mm"}, "grains.spacing: .* permeability; give permeability or grade"),
        (
            {"grains.moment": 0.08, "grains.species.0.remanence": 1.2},
            "grains.moment: .* without a separate remanence",
        ),
        ({"grains.temperature": "5 m"}, "grains.temperature"),
        ({"grains.temperature": 900}, "grains.temperature: .* at most 250"),
    ],
)
def test_inconsistent_magnet_data_are_an_error(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        damper(**changes)


def test_temperature_may_be_given_in_kelvin_or_degrees_celsius() -> None:
    given = ("40", "40 °C", "40 degC", "313.15 K", 40)
    assert [damper(grains__temperature=t).grains.temperature for t in given] == pytest.approx([40.0] * 5)


def test_print_out_of_a_scene_shows_each_factor_of_the_magnetic_moment() -> None:
    parts = damper(grains__grade="N42", grains__coating="15 um", grains__spacing="8.25 mm")
    words = scene_text(parts)
    for step in ("1.28 to 1.32 T", "5.97 x 2.97 mm", "own field", "neighbours", f"{moment(parts):.5g} A m^2"):
        assert step in words
    assert "moment" not in scene_text(damper())
