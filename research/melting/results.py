"""Figures of the layers, and their order."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from research.campaign import Plain, made_now, rounded
from research.melting.transitions import LayerOrder, Transitions, layer_order, transitions

DIGITS = 5


class Results(NamedTuple):
    """Figures of each layer, in rising order of Gamma.

    Attributes
    ----------
    made : mapping
        Command, and versions.
    layers : tuple of dict
        See `research.melting.measures.figures`.
    """

    made: Mapping[str, str]
    layers: tuple[dict[str, Any], ...]

    @property
    def orders(self) -> list[LayerOrder]:
        """Order of each layer."""
        return [_order_of(json.dumps(item)) for item in self.layers]

    @property
    def transitions(self) -> Transitions:
        """Both transitions."""
        return transitions(self.orders)


@functools.lru_cache(maxsize=64)
def _order_of(figures: str) -> LayerOrder:
    """Return the order of a layer from its figures as JSON; cached, since its bootstrap takes long."""
    return layer_order(json.loads(figures))


def results_of(layers: Sequence[dict[str, Any]], command: str) -> Results:
    """Return the results of measured layers."""
    return Results(made_now(command), tuple(sorted(layers, key=lambda item: item["gamma"])))


def from_plain(plain: Any) -> Results:
    """Return results from plain data."""
    return Results(dict(plain["made"]), tuple(plain["layers"]))


def to_plain(results: Results) -> Plain:
    """Return plain data, with numbers to five digits."""
    return {"made": dict(results.made), "layers": rounded(results.layers, DIGITS)}
