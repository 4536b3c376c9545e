"""The columns of a record, by name and by place."""

from __future__ import annotations

from granular.effects.walls import SIDES
from granular.engine import columns, state
from granular.engine.columns import COLUMNS


def test_each_column_has_the_place_that_its_constant_says() -> None:
    places = {name.lower(): place for name, place in vars(columns).items() if name.isupper()}
    del places["columns"]
    assert places == {name: place for place, name in enumerate(COLUMNS)}


def test_walls_and_ledger_fill_columns_in_their_own_order() -> None:
    assert COLUMNS[columns.LEFT : columns.TOP + 1] == SIDES
    entries = ("WORK", "DRAG", "FRICTION", "CONTACT", "PISTON")
    assert [getattr(state, name) for name in entries] == list(range(5))
    ledger = [name.removesuffix("_loss").upper() for name in COLUMNS[columns.WORK :][:5]]
    assert tuple(ledger) == entries
