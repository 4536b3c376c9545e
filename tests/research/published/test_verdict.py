"""Comparison with published values: Welch's test, prediction intervals, printed digits, and bounds."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from granular.shared.errors import InputError
from research.published.catalogue import all_entries
from research.published.entry import (
    Verdict,
    VerdictRule,
    judge_difference_from_published,
    standard_error_of_difference_and_freedom,
)
from research.published.finding import Finding
from research.published.page import SECTIONS
from research.published.results import FigureSample
from validation.measured_quantities import LABELS, keys_of_published_values, published_value, published_values


def found(values: list[float]) -> Finding:
    return FigureSample(np.array(values), "published", "auto").finding()


@pytest.mark.parametrize("shift", [0.0, 0.2, 0.35, 0.45, 0.6, 1.0])
def test_means_are_compared_with_published_means_by_welchs_test(
    shift: float, random: np.random.Generator
) -> None:
    """The outcome agrees with SciPy's two-sample test. A difference has p below 5 %."""
    theirs = np.array([15.02, 15.26, 15.5])
    ours = theirs.mean() + shift + np.array([-0.1, 0.05, 0.05, 0.1, -0.1])
    said = judge_difference_from_published(
        theirs.mean(), theirs.std(ddof=1), found(list(ours)), VerdictRule(), 12
    )
    p = stats.ttest_ind(theirs, ours, equal_var=False).pvalue
    assert said.words == ("differs" if p < 0.05 else "agrees")
    assert said.agrees is bool(p >= 0.05)


def test_scatter_over_packings_is_allowed_only_for_a_single_published_run() -> None:
    """With ten published starts, the mean is accurate even if the scatter is wide."""
    ours = [15.6 + 0.3 * (-1) ** k for k in range(10)]
    assert abs(15.6 - 15.26) < 2.0 * np.std(ours, ddof=1)
    assert (
        judge_difference_from_published(15.26, None, found(ours), VerdictRule(draws=10), 2).words == "differs"
    )
    assert judge_difference_from_published(15.26, None, found(ours), VerdictRule(), 2).words == "agrees"


def test_half_of_the_last_published_digit_is_allowed_as_rounding() -> None:
    assert judge_difference_from_published(0.92, None, found([0.9249, 0.9249]), VerdictRule(), 2).agrees
    assert not judge_difference_from_published(0.92, None, found([0.9251, 0.9251]), VerdictRule(), 2).agrees
    assert judge_difference_from_published(0.920, None, Finding(0.9206), VerdictRule(), 3).agrees is False
    assert judge_difference_from_published(0.920, None, Finding(0.9204), VerdictRule(), 3).agrees is True


def test_published_bounds_are_tested_on_one_side() -> None:
    least = VerdictRule(limit="least")
    assert judge_difference_from_published(0.97, None, Finding(0.99), least, 2).agrees
    assert judge_difference_from_published(0.97, None, Finding(0.96), least, 2).agrees is False
    assert (
        judge_difference_from_published(0.02, None, Finding(0.03), VerdictRule(limit="most"), 2).agrees
        is False
    )


def test_entries_without_a_verdict_state_the_reason() -> None:
    assert judge_difference_from_published(1.0, None, None, VerdictRule(), 2) == Verdict("not run")
    assert judge_difference_from_published(1.0, None, Finding(math.nan), VerdictRule(), 2).words == "not run"
    assert (
        judge_difference_from_published(18.0, None, Finding(0.01), VerdictRule(comparable=False), 1).words
        == "not comparable"
    )
    assert (
        judge_difference_from_published(14.0, None, Finding(14.0), VerdictRule(constructed=True), 4).words
        == "by construction"
    )
    assert (
        judge_difference_from_published(14.0, None, None, VerdictRule(constructed=True), 4).words == "not run"
    )


def test_the_verdict_reports_intervals_so_wide_that_any_value_agrees() -> None:
    """Two very different starts give such an interval."""
    wide, sharp = found([10.0, 20.0]), found([15.1, 15.2, 15.3])
    assert judge_difference_from_published(15.26, 0.24, wide, VerdictRule(), 2).words == "agrees"
    assert not judge_difference_from_published(15.26, 0.24, wide, VerdictRule(), 2).can_fail
    assert judge_difference_from_published(15.26, 0.24, sharp, VerdictRule(), 2).can_fail
    assert not judge_difference_from_published(
        -0.5, None, found([-0.4, -0.6, -0.2]), VerdictRule(), 2
    ).can_fail
    # The allowed difference is half the interval, which must be below a fifth.
    edge = found([0.95, 1.0, 1.05])
    allowed = judge_difference_from_published(1.0, 0.0, edge, VerdictRule(), 12).allowed
    assert allowed is not None
    for size, sharp in ((9.9 * allowed, False), (10.1 * allowed, True)):
        assert judge_difference_from_published(size, 0.0, edge, VerdictRule(), 12).can_fail is sharp


def test_a_result_of_a_single_start_has_no_interval() -> None:
    assert standard_error_of_difference_and_freedom(None, found([3.0])) == (0.0, 0.0)
    assert judge_difference_from_published(3.0, None, found([3.0]), VerdictRule(), 2).p is None
    assert found([3.0]).half_width() is None


@pytest.mark.parametrize(("starts", "draws"), [(3, 1), (3, 3), (10, 1), (10, 10)])
def test_the_prediction_interval_has_its_stated_coverage(
    starts: int, draws: int, random: np.random.Generator
) -> None:
    rule, agreed, p = VerdictRule(draws=draws), [], []
    for _ in range(3000):
        theirs, ours = random.normal(size=draws).mean(), random.normal(size=starts)
        said = judge_difference_from_published(theirs, None, found(list(ours)), rule, 12)
        agreed.append(said.agrees)
        p.append(said.p)
    assert np.mean(agreed) == pytest.approx(0.95, abs=0.02)
    assert stats.kstest(p, "uniform").pvalue > 1e-4


def test_the_worst_of_several_values_has_a_wider_interval(random: np.random.Generator) -> None:
    agreed = []
    for _ in range(2000):
        rows = [
            (random.normal(), Finding(random.normal(0.0, 0.1), 1.0, 100, error=0.1, freedom=99.0))
            for _ in range(10)
        ]
        theirs, ours = max(rows, key=lambda one: abs(one[1].value - one[0]))
        agreed.append(judge_difference_from_published(theirs, None, ours, VerdictRule(looks=10), 12).agrees)
    assert np.mean(agreed) == pytest.approx(0.95, abs=0.02)


GIVEN = Path(__file__).parents[2] / "data" / "published_values.toml"


def covered() -> list[str]:
    return [key for one in all_entries() for key in (one.key, one.spread_key, *one.covers) if key]


def test_every_published_value_is_compared_once() -> None:
    assert sorted(covered()) == sorted(keys_of_published_values())


def test_every_section_names_its_source_tables_and_is_shown_once() -> None:
    shown = [name for sections in SECTIONS.values() for name in sections]
    assert sorted(shown) == sorted(published_values())
    assert all(one["source"] for one in published_values().values())


def test_lists_of_a_section_have_as_many_values_as_labels() -> None:
    for section in published_values().values():
        label = next((section[name] for name in LABELS[1:] if name in section), None)
        lists = [one for one in section.values() if isinstance(one, list)]
        if label is not None:
            assert {len(one) for one in lists} == {len(label)}


def test_published_values_are_found_by_key() -> None:
    assert published_value("piston_force_direct_sum.mean[4]") == 23.23
    assert published_value("damper.van_der_pol_like.alpha") == 0.17
    for key in ("nothing", "damper.nothing", "half_mean_distance.minimum[8]"):
        with pytest.raises(InputError, match="not a published value"):
            published_value(key)


def test_published_values_agree_with_the_given_list_digit_by_digit() -> None:
    given = tomllib.loads(GIVEN.read_text(encoding="utf-8"))
    for section, wanted in given.items():
        here = published_values()[section]
        for name, value in wanted.items():
            assert repr(here[name]) == repr(value), f"{section}.{name}"
