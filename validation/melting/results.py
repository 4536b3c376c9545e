"""What was measured of the layers, as it comes with the package, and what it says."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.files import finite, write_text
from validation.melting.transitions import LayerOrder, Transitions, layer_order, transitions
from validation.results_file import read_results

COMMITTED = Path(__file__).parent / "results.json"
"""The results that come with the package."""

_DIGITS = 5


class Results(NamedTuple):
    """Figures of each layer, in rising order of Gamma.

    Attributes
    ----------
    made : mapping of str to str
        Command, and versions.
    layers : tuple of dict
        See `validation.melting.measures.figures`.
    """

    made: Mapping[str, str]
    layers: tuple[dict[str, Any], ...]

    @property
    def orders(self) -> list[LayerOrder]:
        """What the figures say of each layer."""
        return [layer_order(one) for one in self.layers]

    @property
    def transitions(self) -> Transitions:
        """Both transitions."""
        return transitions(self.orders)


def results_of(layers: Sequence[dict[str, Any]], command: str) -> Results:
    """Results of measured layers."""
    import numba
    import numpy as np

    from granular import __version__

    made = {
        "command": command, "granular-damper": __version__, "numpy": np.__version__,
        "numba": numba.__version__, "processor": platform.machine(),
    }  # fmt: skip
    return Results(made, tuple(sorted(layers, key=lambda one: one["gamma"])))


def write_results(results: Results, path: Path) -> None:
    """Write results; numbers to five digits."""
    plain = {"made": dict(results.made), "layers": [_short(one) for one in results.layers]}
    text = json.dumps(finite(plain), separators=(",", ":")).replace('},{"', '},\n{"')
    write_text(path, text + "\n")


def committed() -> Results:
    """The results that come with the package."""
    return read_results(COMMITTED, from_plain, Results({}, ()))


def from_plain(plain: Any) -> Results:
    """Results from plain data."""
    return Results(dict(plain["made"]), tuple(plain["layers"]))


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _short(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
