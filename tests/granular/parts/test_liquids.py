"""Viscosities of liquids compared with published tables.

Drag coefficients compared with exact flow solutions.
"""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

from granular.parts.liquids import (
    blade_displacement_drag_coefficient,
    blade_drag_coefficient,
    bow_of_plate,
    counter_flow_factor,
    disc_drag_coefficient,
    find_liquid,
    guide_drag_coefficient,
    silicone_oil_viscosity_ratio,
)
from granular.shared.errors import InputError

TABLES: dict[str, tuple[float, dict[int, float]]] = {
    "glycerol 50 %": (0.03, {0: 14.6, 20: 6.00, 40: 3.07}),
    "glycerol 80 %": (0.03, {0: 255.0, 20: 60.1, 40: 20.8}),
    "glycerol 100 %": (0.03, {10: 3900.0, 20: 1410.0, 40: 284.0}),
    "water": (0.001, {20: 1.0016, 25: 0.8900, 60: 0.4660}),
    "air": (0.01, {0: 0.01716, 20: 0.0181, 100: 0.0217}),
}
"""Relative error and viscosities [mPa s]: glycerol in water (Segur and Oberstar 1951,
doi:10.1021/ie50501a040), water (IAPWS 2008, reference values), air (White 2006, table A-2)."""
FITS: dict[str, tuple[float, dict[int, float]]] = {
    "water": (1e-4, {5: 1.5182, 40: 0.65273, 90: 0.31418}),
    "air": (0.015, {-50: 0.014614, 25: 0.018448, 150: 0.024027, 250: 0.02797}),
    "glycerol 20 %": (0.03, {0: 3.3904, 20: 1.7463, 40: 1.092}),
    "glycerol 40 %": (0.03, {0: 7.9108, 20: 3.7012, 40: 2.0945}),
    "glycerol 100 %": (0.036, {10: 3741.5, 20: 1433.5, 40: 292.71, 60: 84.357, 80: 31.582}),
}
"""Published fits from CoolProp 8.0.0 and chemicals 1.5.2: water by IAPWS R12-08, air by Lemmon and Jacobsen
(2004), mixtures by Melinder (2010), glycerol by the VDI Heat Atlas, which differ by 3.5 % at 40 °C."""


@pytest.mark.parametrize(("name", "known"), [*TABLES.items(), *FITS.items()])
def test_viscosities_agree_with_published_tables_and_fits(
    name: str, known: tuple[float, dict[int, float]]
) -> None:
    error, viscosities = known
    found = [1e3 * find_liquid(name, celsius).viscosity for celsius in viscosities]
    np.testing.assert_allclose(found, list(viscosities.values()), rtol=error)


def test_viscosity_ratio_of_silicone_oils_agrees_with_data_sheets() -> None:
    """For 100 to 1000 cSt, data sheets give 1 - nu(98.9)/nu(37.8) = 0.60 to 0.61, with temperatures in
    degrees C.
    """
    ratio = silicone_oil_viscosity_ratio(98.9) / silicone_oil_viscosity_ratio(37.8)
    assert 1.0 - ratio == pytest.approx(0.605, abs=0.006)
    oil = find_liquid("silicone oil 350 cSt", 25.0)
    assert oil.viscosity == pytest.approx(350e-6 * 970.0, rel=1e-12)
    # log nu = 763.1/(273 + T) - 2.559 + log nu_25 at 0 degrees.
    cold = find_liquid("silicone oil 350 mm^2/s", 0.0)
    assert cold.viscosity / cold.density == pytest.approx(350e-6 * 10 ** (763.1 / 273.15 - 2.5594), rel=1e-3)


@pytest.mark.parametrize(
    "name", ["honey", "silicone oil 20 cSt", "glycerol 101 %", "water ", "glycerol 8.0.1 %"]
)
def test_unknown_liquid_is_an_error(name: str) -> None:
    with pytest.raises(InputError, match=r"viscosity|number from"):
        find_liquid(name, 25.0)


def test_temperature_outside_the_range_of_a_liquid_is_an_error() -> None:
    with pytest.raises(InputError, match="known from 0 to 100"):
        find_liquid("water", -5.0)


def test_temperature_dependence_of_silicone_oil_agrees_with_measurement() -> None:
    """Polisil P10 has 3.73 Pa s at -25 degrees C and 1.18 Pa s at 25 (Monteiro et al., J. Plastination)."""
    assert silicone_oil_viscosity_ratio(25.0) == 1.0
    assert silicone_oil_viscosity_ratio(-25.0) == pytest.approx(3.73 / 1.18, rel=0.05)


def test_viscous_drag_of_a_disc_is_the_sum_over_the_liquid_films_on_both_faces() -> None:
    area = math.pi / 4.0 * 0.006**2
    assert disc_drag_coefficient(0.34, area, (5e-5, 5e-5)) == pytest.approx(
        2.0 * 0.34 * area / 5e-5, rel=1e-12
    )
    assert disc_drag_coefficient(0.34, area, (2e-5, 8e-5)) == pytest.approx(
        0.34 * area * (5e4 + 1.25e4), rel=1e-12
    )


@pytest.mark.parametrize(("first", "second"), [(5e-5, 5e-5), (2e-4, 8e-4)])
def test_drag_increase_by_displaced_liquid_agrees_with_the_balance_of_volume_and_energy(
    first: float, second: float
) -> None:
    packing, thickness, viscosity, speed = 0.4, 0.003, 0.1, 0.02
    gap = thickness + first + second

    # The velocity profile is linear in the films, parabolic between discs.
    carried = packing * (thickness + quad(lambda z: 1.0 - z / first, 0.0, first)[0])
    carried += packing * quad(lambda z: 1.0 - z / second, 0.0, second)[0]
    mean = carried * speed / ((1.0 - packing) * gap)
    loss = quad(lambda z: viscosity * (6.0 * mean * (1.0 - 2.0 * z / gap) / gap) ** 2, 0.0, gap)[0]
    films = viscosity * speed**2 * (1.0 / first + 1.0 / second)
    expected = 1.0 + (1.0 - packing) * loss / (packing * films)
    assert counter_flow_factor(packing, thickness, (first, second)) == pytest.approx(expected, rel=1e-9)


def test_drag_increase_by_displaced_liquid_agrees_with_hand_calculation() -> None:
    assert counter_flow_factor(0.4, 0.003, (5e-5, 5e-5)) == pytest.approx(1.06, abs=0.01)
    assert counter_flow_factor(0.55, 0.003, (5e-4, 5e-4)) == pytest.approx(1.70, abs=0.01)


def test_drag_on_the_piston_blade_is_the_sum_of_shear_and_pressure_drag() -> None:
    assert blade_drag_coefficient(0.0884, 0.36, 0.01, 5e-5) == pytest.approx(12.73, abs=0.01)
    # Plane flow between fixed walls has the pressure gradient 12 eta u/h^2 at mean speed u.
    gradient = 12.0 * 0.0884 * (0.003 * 1.0 / (2.0 * 5e-5)) / 5e-5**2
    expected = gradient * 0.01 * 0.36 * 0.003
    assert blade_displacement_drag_coefficient(0.0884, 0.36, 0.01, 0.003, 5e-5) == pytest.approx(
        expected, rel=1e-12
    )


def test_drag_in_a_concentric_piston_guide_agrees_with_annular_shear_flow() -> None:
    """The shear flow between two cylinders solves (r v')' = 0."""
    inner, outer, viscosity, length = 0.006, 0.007, 0.34, 0.03
    r = np.linspace(inner, outer, 50)
    flow = solve_bvp(
        lambda r, y: np.stack([y[1], -y[1] / r]),
        lambda a, b: np.array([a[0] - 1.0, b[0]]),
        r,
        np.stack([1.0 - (r - inner) / (outer - inner), np.full(50, -1000.0)]),
        tol=1e-9,
    )
    force = -viscosity * flow.sol(inner)[1] * 2.0 * math.pi * inner * length
    assert guide_drag_coefficient(viscosity, 2.0 * inner, length, outer - inner) == pytest.approx(
        force, rel=1e-6
    )


def test_drag_in_an_eccentric_piston_guide_agrees_with_thin_film_theory() -> None:
    """In a film of thickness c (1 + e cos t), the drag is 1/sqrt(1 - e^2) times the drag in a uniform
    film.
    """
    clearance, e = 1e-6, 0.8
    ring = quad(lambda t: 1.0 / (1.0 + e * math.cos(t)), 0.0, 2.0 * math.pi)[0]
    expected = 0.34 * 0.006 * 0.03 / clearance * ring
    assert guide_drag_coefficient(0.34, 0.012, 0.03, clearance, e) == pytest.approx(expected, rel=1e-3)


def test_deflection_of_a_glass_plate_agrees_with_beam_theory() -> None:
    """A plate of 360 x 59.1 x 5 mm, clamped at two edges, bends by about 0.1 mm under a load of 42 N."""
    bow = bow_of_plate(42.0, 0.36, 0.0591, 0.005)
    stiffness = 70e9 * 0.005**3 / (12.0 * (1.0 - 0.22**2))
    x = np.linspace(0.0, 0.36, 30)
    beam = solve_bvp(
        lambda x, y: np.stack([y[1], y[2], y[3], np.full_like(x, 42.0 / (0.36 * 0.0591) / stiffness)]),
        lambda a, b: np.array([a[0], a[1], b[0], b[1]]),
        x,
        np.zeros((4, 30)),
        tol=1e-8,
    )
    assert bow.clamped == pytest.approx(float(beam.sol(0.18)[0]), rel=1e-4)
    assert bow.supported == pytest.approx(5.0 * bow.clamped, rel=1e-12)
    assert 0.1e-3 < bow.clamped < bow.supported < 0.6e-3
