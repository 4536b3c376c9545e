"""The published values, and that every one of them has its entry."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from granular.shared.errors import InputError
from research.published.catalogue import entries
from research.published.page import SECTIONS
from validation.measured_quantities import LABELS, published_keys, published_value, published_values

GIVEN = Path(__file__).parents[2] / "data" / "published_values.toml"


def covered() -> list[str]:
    return [key for one in entries() for key in (one.key, one.spread_key, *one.covers) if key]


def test_every_value_has_one_entry() -> None:
    assert sorted(covered()) == sorted(published_keys())


def test_every_section_names_its_tables_and_is_shown_once() -> None:
    shown = [name for sections in SECTIONS.values() for name in sections]
    assert sorted(shown) == sorted(published_values())
    assert all(one["source"] for one in published_values().values())


def test_lists_of_a_section_have_the_length_of_their_labels() -> None:
    for section in published_values().values():
        label = next((section[name] for name in LABELS[1:] if name in section), None)
        lists = [one for one in section.values() if isinstance(one, list)]
        if label is not None:
            assert {len(one) for one in lists} == {len(label)}


def test_values_are_found_by_key() -> None:
    assert published_value("piston_force_direct_sum.mean[4]") == 23.23
    assert published_value("damper.van_der_pol_like.alpha") == 0.17
    for key in ("nothing", "damper.nothing", "half_mean_distance.minimum[8]"):
        with pytest.raises(InputError, match="no published value"):
            published_value(key)


def test_the_given_list_is_complete_here() -> None:
    given = tomllib.loads(GIVEN.read_text(encoding="utf-8"))
    for section, wanted in given.items():
        here = published_values()[section]
        for name, value in wanted.items():
            assert repr(here[name]) == repr(value), f"{section}.{name}"
