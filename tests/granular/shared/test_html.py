"""Reports: figures whose letters can be read on a phone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from granular.shared.html import Page
from granular.shared.plotting import READABLE, figure


@pytest.mark.parametrize(("size", "fits"), [(READABLE, True), (7.0, False)])
def test_the_smallest_letters_are_nine_pixels(size: float, fits: bool) -> None:
    with figure(width=7.2, size=size) as (drawing, axes):
        axes.set_xlabel("time [s]")
    page = Page("report")
    page.figure(drawing, "a motion")
    (least,) = map(float, re.findall(r'style="--least:(\d+)px"', page.render()))
    assert size * least / (72.0 * 7.2) == pytest.approx(9.0, abs=0.02)
    assert (least <= 358.0) == fits  # a phone's 390 pixels without the page's rims


def test_a_page_leads_to_the_files_beside_it(tmp_path: Path) -> None:
    page = Page("report")
    page.link("more & more", 'a "page".html')
    page.save(tmp_path / "report.html")
    said = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert '<a href="a &quot;page&quot;.html">more &amp; more</a>' in said
