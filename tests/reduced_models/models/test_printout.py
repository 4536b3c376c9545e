"""Blocks of the print-outs: figures as an engineer writes them."""

from __future__ import annotations

import dataclasses
import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import Parameter, fit, load_model
from reduced_models.models.printed_model import swing_quantities
from reduced_models.models.printout import caution_lines, equation_lines, figure_lines, format_percent
from reduced_models.models.quantities import QuantityWithError

SAVED = Path(__file__).parents[2] / "data" / "model.json"
TIME = np.linspace(0.0, 2.0, 2000)


def quantity(value: float, error: float, unit: str = "mm") -> QuantityWithError:
    return QuantityWithError("a", "a", unit, value, {"fit": error})


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (2.3111159e-30, 0.0, "2.31112e-30 mm"),  # no figure of `fit`, see below
        (0.80000000001, 1e-13, "0.8 mm"),
        (1744.76931503685, 12.3, "1745 ± 12 mm"),
        (59.113399, 0.021, "59.113 ± 0.021 mm"),
        (-4.7e-7, 1.0e-6, "-5e-07 ± 1e-06 mm"),
        (5.0, math.inf, "5.000 mm (not determined)"),
    ],
)
def test_a_figure_has_the_digits_that_its_error_is_worth(value: float, error: float, text: str) -> None:
    assert quantity(value, error).text_with_error == text


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(3.83e-12, "< 0.0001 %"), (0.0194, "1.94 %"), (12.345, "1234 %"), (math.inf, "diverges"), (0.0, "0 %")],
)
def test_relative_errors_in_per_cent(fraction: float, text: str) -> None:
    assert format_percent(fraction) == text


def test_no_parameter_is_cut_off() -> None:
    """Twelve numbers take as many lines as they need, and no line breaks within one."""
    values = tuple(
        QuantityWithError(f"c{k}", f"c{k}", "1/(m s^2)", 1e4 + k, {"fit": 12.0}) for k in range(12)
    )
    lines = equation_lines("z'' = " + " + ".join(f"c{k}*z**{k}" for k in range(12)), values, {})
    assert max(map(len, lines)) <= 100
    assert "..." not in "".join(lines)
    for item in values:
        assert sum(f"{item.name} {item.text_with_error}" in line for line in lines) == 1


def test_an_interval_that_is_not_about_its_value_is_printed_as_one() -> None:
    (_, line) = equation_lines("z'' = -k*z", [quantity(2.0, 0.5, "1/s^2")], {"a": (1.8, 2.8)})
    assert line.strip() == "a 2.00 1/s^2 (1.80 to 2.80)"


def test_figures_in_an_engineer_s_words() -> None:
    model = load_model(SAVED)
    lines = figure_lines(swing_quantities(model, 7.5), 7.5, 0.95, "1 to 2 mm: constant")
    assert [line.split("  ")[1] for line in lines[:-1]] == [
        "natural frequency",
        "damping ratio",
        "stiffness",
        "equilibrium",
        "amplitude",
    ]
    assert "(for 7.5 kg)" in lines[2]
    assert lines[5] == "  these ± are 95 % intervals: fit"
    assert lines[4].index("1 to 2 mm") == lines[0].index(lines[0].split("f0")[1].strip()[:4])


def test_a_motion_about_zero_without_noise_has_its_equilibrium_there() -> None:
    """The root finder's 1e-37 is 0, and no number has fifteen digits."""
    swing = 1e-3 * np.exp(-0.8 * TIME) * np.cos(21.8 * TIME)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(
            PistonRecord(TIME, swing), "linear", starts=2, parameters={"g0": Parameter(0.0, fixed=True)}
        )
    assert model.at_rest is not None
    assert model.at_rest.height == 0.0
    assert "z0    0 mm" in str(model)
    assert max(map(len, str(model).replace(",", " ").split())) < 15
    assert model.printed_digits <= 9


def test_cautions_are_whole_or_counted() -> None:
    words = ["the record " + "rounds " * 20, "a", "b", "c"]
    lines = caution_lines(words, 4)
    assert len(lines) <= 4
    assert lines[-1] == "2 more: --verbose, or the report" or lines[-1].startswith("3 more")
    assert caution_lines(words) == [*caution_lines(words[:1]), "caution: a", "caution: b", "caution: c"]


def test_an_angle_is_printed_in_degrees() -> None:
    model = load_model(SAVED)
    assert model.at_rest is not None
    turned = dataclasses.replace(model.at_rest, coordinate_unit="rad")
    assert " °" in str(turned)
    assert " mm" not in str(turned)


def test_the_small_motion_as_a_row_of_a_table() -> None:
    rest = load_model(SAVED).at_rest
    assert rest is not None
    row = rest.to_series()
    assert list(row.index) == [
        "height",
        "period",
        "damping_ratio",
        "height_error",
        "period_error",
        "damping_ratio_error",
    ]
    low, high = rest.intervals["period"]
    assert row["period_error"] == pytest.approx(0.5 * (high - low))
