"""Liquids against tables that others published."""

import pytest

from granular.parts.liquids import find_liquid, silicone_oil_viscosity_ratio
from granular.shared.errors import InputError

# Glycerol and water [mPa s] (Segur and Oberstar 1951, doi:10.1021/ie50501a040), water [mPa s]
# (IAPWS 2008, checked there), air [uPa s] (White 2006, table A-2).
TABLES = {
    "glycerol 50 %": {0: 14.6, 20: 6.00, 40: 3.07},
    "glycerol 80 %": {0: 255.0, 20: 60.1, 40: 20.8},
    "glycerol 100 %": {10: 3900.0, 20: 1410.0, 40: 284.0},
    "water": {20: 1.0016, 25: 0.8900, 60: 0.4660},
    "air": {0: 0.01716, 20: 0.0181, 100: 0.0217},
}
OFF = {"water": 0.001, "air": 0.01}


@pytest.mark.parametrize("name", TABLES)
def test_liquids_have_the_viscosities_of_tables(name: str) -> None:
    for celsius, viscosity in TABLES[name].items():
        found = find_liquid(name, celsius).viscosity
        assert 1e3 * found == pytest.approx(viscosity, rel=OFF.get(name, 0.03))


# [mPa s], as CoolProp 8.0.0 and chemicals 1.5.2 evaluate the fits that others published: water by IAPWS
# R12-08, air by Lemmon and Jacobsen (2004), mixtures by Melinder (2010), glycerol by the VDI Heat Atlas.
FITS = {
    "water": {5: 1.5182, 40: 0.65273, 90: 0.31418},
    "air": {-50: 0.014614, 25: 0.018448, 150: 0.024027, 250: 0.02797},
    "glycerol 20 %": {0: 3.3904, 20: 1.7463, 40: 1.092},
    "glycerol 40 %": {0: 7.9108, 20: 3.7012, 40: 2.0945},
    "glycerol 100 %": {10: 3741.5, 20: 1433.5, 40: 292.71, 60: 84.357, 80: 31.582},
}
OFF_FITS = {"water": 1e-4, "air": 0.015, "glycerol 100 %": 0.036}


@pytest.mark.parametrize("name", FITS)
def test_liquids_have_the_viscosities_of_the_fits_of_others(name: str) -> None:
    """Within 3 %, and glycerol within 3.6 %: its formula and the other fit are 3.5 % apart at 40 degrees."""
    for celsius, viscosity in FITS[name].items():
        found = find_liquid(name, celsius).viscosity
        assert 1e3 * found == pytest.approx(viscosity, rel=OFF_FITS.get(name, 0.03))


def test_silicone_oils_follow_one_curve_through_what_is_sold() -> None:
    """Fluids of 100 to 1000 cSt are sold with 1 - nu(98.9)/nu(37.8) of 0.60 to 0.61."""
    ratio = silicone_oil_viscosity_ratio(98.9) / silicone_oil_viscosity_ratio(37.8)
    assert 1.0 - ratio == pytest.approx(0.605, abs=0.006)
    oil = find_liquid("silicone oil 350 cSt", 25.0)
    assert oil.viscosity == pytest.approx(350e-6 * 970.0, rel=1e-12)
    # log nu = 763.1/(273 + T) - 2.559 + log nu_25, by hand at 0 degrees.
    cold = find_liquid("silicone oil 350 mm^2/s", 0.0)
    assert cold.viscosity / cold.density == pytest.approx(350e-6 * 10 ** (763.1 / 273.15 - 2.5594), rel=1e-3)


@pytest.mark.parametrize(
    "name", ["honey", "silicone oil 20 cSt", "glycerol 101 %", "water ", "glycerol 8.0.1 %"]
)
def test_unknown_liquids_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"viscosity|number from"):
        find_liquid(name, 25.0)


def test_a_liquid_is_known_between_two_temperatures() -> None:
    with pytest.raises(InputError, match="known from 0 to 100"):
        find_liquid("water", -5.0)


def test_viscosity_of_an_oil_falls_as_measured() -> None:
    """Polisil P10 has 3.73 Pa s at -25 degrees and 1.18 Pa s at 25 (Monteiro et al., J. Plastination)."""
    assert silicone_oil_viscosity_ratio(25.0) == 1.0
    assert silicone_oil_viscosity_ratio(-25.0) == pytest.approx(3.73 / 1.18, rel=0.05)
