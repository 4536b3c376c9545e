"""Reports: figures whose letters can be read on a phone."""

import re

import pytest

from granular.shared.blocks import Picture
from granular.shared.html_pages import Page
from granular.shared.plotting import READABLE, figure, label_log_axis_plainly


@pytest.mark.parametrize(("size", "fits"), [(READABLE, True), (7.0, False)])
def test_the_smallest_letters_are_nine_pixels(size: float, fits: bool) -> None:
    with figure(width=7.2, size=size) as (drawing, axes):
        axes.set_xlabel("time [s]")
    page = Page("report", "", [Picture(lambda: drawing, "a motion")])
    (least,) = map(float, re.findall(r'style="--least:(\d+)px"', page.to_html()))
    assert size * least / (72.0 * 7.2) == pytest.approx(9.0, abs=0.02)
    assert (least <= 358.0) == fits  # a phone's 390 pixels without the page's rims


@pytest.mark.parametrize("values", [(0.1, 3.0, 20.0), (1.2, 1.6, 2.4), (1e-5, 3.0)])
def test_a_logarithmic_axis_has_no_small_exponents(values: tuple[float, ...]) -> None:
    with figure() as (drawing, axes):
        axes.plot(values)
        axes.set_yscale("log")
        label_log_axis_plainly(axes.yaxis)
        drawing.draw_without_rendering()
        ticks = [*axes.yaxis.get_major_ticks(), *axes.yaxis.get_minor_ticks()]
        labels = [tick.label1.get_text() for tick in ticks]
    assert any(labels)
    assert all(re.fullmatch(r"[\d.e+\u2212-]*", one) for one in labels), labels
