"""Test whether any temperature orders heated, shaken, compressed and settled beds."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from granular.shared.files import digest
from research.disorder.beds import DisorderBed, scene_of_bed
from research.disorder.candidates import CANDIDATES, ORDERS, measure_candidates_and_orders
from research.disorder.data_collapse import DRAWS, CollapseQuality, judge_collapse

Row = dict[str, Any]

FALLING = ("psi6",)
"""Measures of order that decrease with temperature if the others increase."""

AGITATED = ("bath", "shaken")
"""Kinds of driving that keep the grains moving about their positions."""


def key_of_bed(bed: DisorderBed) -> str:
    """Return the key of the row of a bed."""
    return f"{bed.key}-{digest(scene_of_bed(bed).to_plain(), 8)}"


def simulate_and_measure_bed(bed: DisorderBed) -> Row:
    """Simulate and measure a bed."""
    from granular.run.simulation import simulate

    with warnings.catch_warnings():
        # Point dipoles of hot beds come closer than a diameter; ``closest`` gives the distance.
        warnings.simplefilter("ignore", UserWarning)
        run = simulate(scene_of_bed(bed), progress=False)
    return bed._asdict() | measure_candidates_and_orders(run)


def judge_candidates_by_order(
    rows: Sequence[Mapping[str, Any]], groups: Sequence[str], draws: int | None = None
) -> dict[tuple[str, str], CollapseQuality]:
    """Return `collapse` of each candidate with each order, over the rows of some kinds of driving.

    ``draws`` is `DRAWS` if not given.
    """
    chosen = [row for row in rows if row["group"] in groups]
    columns = tuple(tuple(row[name] for row in chosen) for name in (*CANDIDATES, *ORDERS))
    owners = tuple(row["group"] for row in chosen)
    return _judge_candidates_from_columns(owners, columns, DRAWS if draws is None else draws)


@lru_cache(maxsize=8)
def _judge_candidates_from_columns(
    owners: tuple[str, ...], columns: tuple[tuple[float, ...], ...], draws: int
) -> dict[tuple[str, str], CollapseQuality]:
    table = dict(zip((*CANDIDATES, *ORDERS), map(np.array, columns), strict=True))
    return {
        (candidate, order): judge_collapse(
            table[candidate], table[order] * (-1.0 if order in FALLING else 1.0), owners, draws
        )
        for order in ORDERS
        for candidate in CANDIDATES
    }


def candidates_that_order_all_quantities(judged: Mapping[tuple[str, str], CollapseQuality]) -> list[str]:
    """Return the candidates that order all quantities."""
    return [item for item in CANDIDATES if all(judged[item, order].orders for order in ORDERS)]
