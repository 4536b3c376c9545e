"""Measured figures of the layers, and their orientational and translational order."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from research.campaign import Plain, command_date_and_versions, round_floats_in_plain_data
from research.melting.transitions import (
    LayerOrder,
    MeltingTransitions,
    find_transitions,
    layer_order_from_figures,
)

DIGITS = 5


class MeltingResults(NamedTuple):
    """Figures of each layer, in rising order of Gamma.

    Attributes
    ----------
    made : mapping
        Command, and versions.
    layers : tuple of dict
        See `research.melting.measures.measure_layer`.
    """

    made: Mapping[str, str]
    layers: tuple[dict[str, Any], ...]

    @property
    def orders(self) -> list[LayerOrder]:
        """Order of each layer."""
        return [_layer_order_from_json(json.dumps(item)) for item in self.layers]

    @property
    def transitions(self) -> MeltingTransitions:
        """Both transitions."""
        return find_transitions(self.orders)


@functools.lru_cache(maxsize=64)
def _layer_order_from_json(figures: str) -> LayerOrder:
    """Return the order of a layer from its figures as JSON; cached, since its bootstrap takes long."""
    return layer_order_from_figures(json.loads(figures))


def make_results(layers: Sequence[dict[str, Any]], command: str) -> MeltingResults:
    """Return the results of measured layers."""
    return MeltingResults(
        command_date_and_versions(command), tuple(sorted(layers, key=lambda item: item["gamma"]))
    )


def results_from_plain(plain: Any) -> MeltingResults:
    """Return results from plain data."""
    return MeltingResults(dict(plain["made"]), tuple(plain["layers"]))


def results_to_plain(results: MeltingResults) -> Plain:
    """Return plain data, with numbers to five digits."""
    return {"made": dict(results.made), "layers": round_floats_in_plain_data(results.layers, DIGITS)}
