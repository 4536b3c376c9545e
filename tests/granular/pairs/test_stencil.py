"""Splines of a mesh about a grain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from granular.compiled import entry
from granular.pairs import spline_stencil

STRIDE = 12

AT = 2 * STRIDE + 3


@entry
def put(values: np.ndarray, u: float, v: float, amount: float) -> None:
    spline_stencil.add_spline_weights(values, AT, STRIDE, u, v, amount)


@entry
def sums(values: np.ndarray, u: float, v: float) -> tuple[float, float, float]:
    return spline_stencil.interpolate_with_splines(values, AT, STRIDE, u, v)


def splines(way: float, slope: int = 0) -> np.ndarray:
    """Of the four points about a place, each by its own knots."""
    found = [
        BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)(way + 1.0 - point, nu=slope)
        for point in range(4)
    ]
    return np.nan_to_num(np.array(found))


@pytest.mark.parametrize(("u", "v"), [(0.25, 0.7), (0.999, 0.001), (0.0, 0.5)])
def test_what_is_put_and_found_are_products_of_splines(u: float, v: float) -> None:
    values = np.random.default_rng(1).standard_normal(8 * STRIDE)
    points = values.reshape(8, STRIDE)[2:6, 3:7].copy()
    value, by_u, by_v = sums(values, u, v)
    assert value == pytest.approx(splines(v) @ points @ splines(u), abs=1e-14)
    assert by_u == pytest.approx(splines(v) @ points @ splines(u, 1), abs=1e-14)
    assert by_v == pytest.approx(splines(v, 1) @ points @ splines(u), abs=1e-14)
    before = values.copy()
    put(values, u, v, 2.5)
    added = (values - before).reshape(8, STRIDE)
    np.testing.assert_allclose(added[2:6, 3:7], 2.5 * np.outer(splines(v), splines(u)), atol=1e-14)
    added[2:6, 3:7] = 0.0
    assert not added.any()
