"""The columns of a record, by name and by place."""

from __future__ import annotations

import numpy as np

from granular.engine import columns
from granular.engine.columns import COLUMNS


def test_each_column_has_the_place_that_its_constant_says() -> None:
    places = {name.lower(): place for name, place in vars(columns).items() if name.isupper()}
    del places["columns"], places["type_checking"]
    assert places.pop("energies") == len(COLUMNS)
    assert places == {name: place for place, name in enumerate(COLUMNS)}


def test_energies_and_losses_of_laws_are_in_the_sums() -> None:
    names = columns.column_names(2)
    assert len(names) == columns.ledger_column_count(2)
    row = np.zeros((1, len(names)))
    wanted = {"kinetic": 1.0, "pair": 2.0, "piston": 4.0}
    for place, name in enumerate(("kinetic", "pair", "piston")):
        row[0, names.index(name)] = 2.0**place
    for law in range(2):
        row[0, names.index(columns.energy_column(law))] = 8.0 * 2**law
        row[0, names.index(columns.loss_column(law))] = 32.0 * 2**law
    row[0, columns.PISTON_LOSS] = 128.0
    assert columns.total_potential_energies(row)[0] == wanted["pair"] + 8.0 + 16.0
    assert columns.total_energies(row)[0] == sum(wanted.values()) + 8.0 + 16.0
    assert columns.total_losses(row)[0] == 32.0 + 64.0 + 128.0
