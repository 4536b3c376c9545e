"""Which temperature orders beds that are heated, shaken, compressed or settled, if any does."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from granular.shared.files import digest
from research.disorder.beds import Bed, scene_of
from research.disorder.candidates import CANDIDATES, ORDERS, measured
from research.disorder.data_collapse import DRAWS, Collapse, collapse

Row = dict[str, Any]

FALLING = ("psi6",)
"""Orders that fall where the others rise."""

AGITATED = ("bath", "shaken")
"""Ways of driving that move the grains about their places all the time."""


def bed_key(bed: Bed) -> str:
    """Name under which the row of a bed is kept."""
    return f"{bed.key}-{digest(scene_of(bed).to_plain(), 8)}"


def bed_row(bed: Bed) -> Row:
    """A bed simulated and measured."""
    from granular.run.simulation import simulate

    with warnings.catch_warnings():
        # Point dipoles of hot beds come nearer than a diameter; ``closest`` tells it of each.
        warnings.simplefilter("ignore", UserWarning)
        run = simulate(scene_of(bed), progress=False)
    return bed._asdict() | measured(run)


def judged_candidates(
    rows: Sequence[Mapping[str, Any]], groups: Sequence[str], draws: int | None = None
) -> dict[tuple[str, str], Collapse]:
    """`collapse` of each candidate with each order, over the rows of some ways of driving.

    ``draws`` is `DRAWS` if not given.
    """
    chosen = [row for row in rows if row["group"] in groups]
    columns = tuple(tuple(row[name] for row in chosen) for name in (*CANDIDATES, *ORDERS))
    owners = tuple(row["group"] for row in chosen)
    return _judge_steps(owners, columns, DRAWS if draws is None else draws)


@lru_cache(maxsize=8)
def _judge_steps(
    owners: tuple[str, ...], columns: tuple[tuple[float, ...], ...], draws: int
) -> dict[tuple[str, str], Collapse]:
    table = dict(zip((*CANDIDATES, *ORDERS), map(np.array, columns), strict=True))
    return {
        (candidate, order): collapse(
            table[candidate], table[order] * (-1.0 if order in FALLING else 1.0), owners, draws
        )
        for order in ORDERS
        for candidate in CANDIDATES
    }


def orders_all(judged: Mapping[tuple[str, str], Collapse]) -> list[str]:
    """Candidates that order each of the orders."""
    return [item for item in CANDIDATES if all(judged[item, order].orders for order in ORDERS)]
