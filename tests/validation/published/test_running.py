"""Cases that are kept, found again, and do not lose each other."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation.published.page import page
from validation.published.plan import Group
from validation.published.protocols import QUICK
from validation.published.results import Results, collected
from validation.published.running import outcomes_of, run_groups
from validation.published.series import Series, mixture, mono

SMALL = QUICK._replace(speed=0.3, settling=0.5)


def small(name: str, step: float | str) -> Series:
    return mono(name, 12, SMALL, seeds=(1, 2), step=step)


@pytest.fixture(scope="module")
def groups() -> list[Group]:
    return [Group("small", [small("direct 368", "auto"), small("direct 736", 0.02)])]


@pytest.fixture(scope="module")
def kept(groups: list[Group], tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("cases")
    run_groups(groups, directory, workers=1, progress=False)
    return directory


def test_a_case_that_fails_loses_no_other(groups: list[Group], kept: Path) -> None:
    good, bad = groups[0].series
    assert [one["error"] for one in outcomes_of(good, kept)] == [None, None]
    assert all(one["error"] for one in outcomes_of(bad, kept))
    found = collected(groups, kept, "test")
    assert len(found.series[bad.key]["errors"]) == 2
    assert found.series[bad.key]["errors"][0] in page(found).render().replace("&#x27;", "'")


def test_what_was_run_is_found_again(groups: list[Group], kept: Path) -> None:
    def times() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in (kept / "cases").iterdir()}

    before = times()
    assert len(before) == 4
    calls: list[int] = []
    run_groups(groups, kept, workers=1, progress=False, after=lambda: calls.append(1))
    assert times() == before
    assert calls == [1]
    assert len(outcomes_of(small("direct 368", "auto")._replace(seeds=(1, 2, 3)), kept)) == 2


def test_figures_of_a_bed_fit_its_geometry(groups: list[Group], kept: Path) -> None:
    figures = collected(groups, kept, "test").series[groups[0].series[0].key]["figures"]
    size = (12 / 368) ** 0.5
    for start in range(2):
        assert figures["down"][start][-1] == pytest.approx(figures["force"][start])
        assert 0.0 < figures["least_distance_D"][start] < 20.0 * size
        # The mean distance of two grains is between a grain's and the cell's diagonal.
        assert 0.5 < figures["half_full_D"][start] < 0.5 * (60.0**2 + 20.0**2) ** 0.5 * size
        assert figures["half_full_D"][start] < figures["half_end_D"][start]
        # 12 grains of 6 mm in a cell of 60 by 20 diameters times the size.
        assert figures["packing"][start] == pytest.approx(368 * 3.14159 / 4 / 1200, rel=1e-4)


def test_series_of_a_mixture_name_their_protocol() -> None:
    one = mixture("mixture", 0.6, 0.5, QUICK)
    assert one.words == "quick: 16 mm/s after 5 T"
    assert one.key == "mixture | quick"
    scene = one.scene(1)
    assert [stage.name for stage in scene.protocol] == ["relax", "compress"]
    assert scene.grains.shares() == (0.5, 0.5)
    assert Results({}, {}, {}).sample("mixture", "force") is None
