"""Drags and bows against other ways to them: quadrature, the flow's own equation, a beam."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

from granular.parts.liquids import (
    blade_displacement_drag,
    blade_drag,
    bow_of_plate,
    counter_flow_factor,
    disc_drag,
    guide_drag,
)


def test_disc_between_plates_feels_both_films() -> None:
    area = math.pi / 4.0 * 0.006**2
    assert disc_drag(0.34, area, (5e-5, 5e-5)) == pytest.approx(2.0 * 0.34 * area / 5e-5, rel=1e-12)
    assert disc_drag(0.34, area, (2e-5, 8e-5)) == pytest.approx(0.34 * area * (5e4 + 1.25e4), rel=1e-12)


@pytest.mark.parametrize(("first", "second"), [(5e-5, 5e-5), (2e-4, 8e-4)])
def test_flow_back_carries_what_discs_and_films_carry_and_takes_its_work(first: float, second: float) -> None:
    packing, thickness, viscosity, speed = 0.4, 0.003, 0.1, 0.02
    gap = thickness + first + second

    # In the films the velocity falls evenly from the disc's to 0; between discs it is a parabola.
    carried = packing * (thickness + quad(lambda z: 1.0 - z / first, 0.0, first)[0])
    carried += packing * quad(lambda z: 1.0 - z / second, 0.0, second)[0]
    mean = carried * speed / ((1.0 - packing) * gap)
    loss = quad(lambda z: viscosity * (6.0 * mean * (1.0 - 2.0 * z / gap) / gap) ** 2, 0.0, gap)[0]
    films = viscosity * speed**2 * (1.0 / first + 1.0 / second)
    expected = 1.0 + (1.0 - packing) * loss / (packing * films)
    assert counter_flow_factor(packing, thickness, (first, second)) == pytest.approx(expected, rel=1e-9)


def test_counter_flow_adds_what_was_estimated() -> None:
    assert counter_flow_factor(0.4, 0.003, (5e-5, 5e-5)) == pytest.approx(1.06, abs=0.01)
    assert counter_flow_factor(0.55, 0.003, (5e-4, 5e-4)) == pytest.approx(1.70, abs=0.01)


def test_blade_of_the_packaged_damper() -> None:
    assert blade_drag(0.0884, 0.36, 0.01, 5e-5) == pytest.approx(12.73, abs=0.01)
    # A plane flow between walls at rest has the gradient 12 eta u/h^2 at its mean speed u.
    gradient = 12.0 * 0.0884 * (0.003 * 1.0 / (2.0 * 5e-5)) / 5e-5**2
    expected = gradient * 0.01 * 0.36 * 0.003
    assert blade_displacement_drag(0.0884, 0.36, 0.01, 0.003, 5e-5) == pytest.approx(expected, rel=1e-12)


def test_concentric_guide_is_the_flow_in_a_ring() -> None:
    """The shear between two cylinders solves (r v')' = 0."""
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
    assert guide_drag(viscosity, 2.0 * inner, length, outer - inner) == pytest.approx(force, rel=1e-6)


def test_guide_off_its_axis_is_that_of_a_thin_film() -> None:
    """In a film of c (1 + e cos t) the drag is the integral of eta r/film: 1/sqrt(1 - e^2) of the mean."""
    clearance, e = 1e-6, 0.8
    ring = quad(lambda t: 1.0 / (1.0 + e * math.cos(t)), 0.0, 2.0 * math.pi)[0]
    expected = 0.34 * 0.006 * 0.03 / clearance * ring
    assert guide_drag(0.34, 0.012, 0.03, clearance, e) == pytest.approx(expected, rel=1e-3)


def test_glass_bows_as_much_as_the_gap() -> None:
    """42 N on 360 x 59.1 mm of glass of 5 mm: a strip with clamped edges, by the beam's equation."""
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
