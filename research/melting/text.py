"""Tables of the layers, for the console and for the guide."""

from __future__ import annotations

import math
from typing import Any

from research.campaign import markdown_table
from research.melting.results import MeltingResults
from research.melting.transitions import BootstrapInterval

_HEAD = (
    "Gamma",
    "translation",
    "psi6",
    "eta6",
    "power/exp.",
    "K/16pi",
    "plateau",
    "Lindemann",
    "growth",
    "defects",
)


def results_as_plain_data(results: MeltingResults) -> dict[str, Any]:
    """Return plain data: order of each layer, and the transitions."""
    return {
        "made": dict(results.made),
        "layers": [
            {name: _plain_interval(value) for name, value in item._asdict().items()}
            for item in results.orders
        ],
        "transitions": {
            name: _plain_interval(value) for name, value in results.transitions._asdict().items()
        },
    }


def _plain_interval(value: Any) -> Any:
    return value._asdict() if isinstance(value, BootstrapInterval) else value


def layer_rows(results: MeltingResults) -> list[tuple[str, ...]]:
    """Return a row of texts for each layer."""
    return [
        (
            f"{item.gamma:g}",
            f"{item.translation:.2f}",
            f"{item.order:.3f}",
            _scaled_interval_text(item.exponent, 1.0, 3),
            f"{item.algebraic:.2f}",
            _scaled_interval_text(item.modulus, 1.0 / (16.0 * math.pi), 2),
            "" if math.isnan(item.plateau) else f"{item.plateau:.4f}",
            f"{item.lindemann:.3g}",
            f"{item.growth:.2f}",
            f"{100.0 * item.defects:.1f} %",
        )
        for item in results.orders
    ]


def _scaled_interval_text(item: BootstrapInterval, scale: float, digits: int) -> str:
    if not math.isfinite(item.value):
        return "lost"
    if item.value == 0.0:
        return "0"
    value, low, high = (f"{scale * number:.{digits}f}" for number in item)
    return f"{value} ({low} to {high})"


def transitions_text(results: MeltingResults) -> str:
    """Return the text on the transitions."""
    result = results.transitions
    return "\n".join(
        f"{what}: {'not reached' if item is None else _gamma_text(item)}"
        for what, item in (
            ("eta6 is 1/4 at Gamma", result.hexatic),
            ("K is 16 pi at Gamma", result.crystal),
            ("the plateau of the Lindemann parameter is 0.033 at Gamma", result.lindemann),
            ("crystalline down to Gamma", result.kept),
            ("not crystalline up to Gamma", result.lost),
        )
    )


def _gamma_text(item: BootstrapInterval | float) -> str:
    if isinstance(item, float):
        return f"{item:.1f}"
    return f"{item.value:.1f} ({item.low:.1f} to {item.high:.1f})"


def table_text(results: MeltingResults) -> str:
    """Return the table for the console."""
    from granular.shared.blocks import Table

    if not results.layers:
        return "no results are committed; run it with --quick or --full"
    grains = results.layers[0]["grains"]
    return f"{Table(_HEAD, layer_rows(results))}\n{grains} grains\n{transitions_text(results)}"


def table_and_transitions_markdown(results: MeltingResults) -> str:
    """Return the table and the transitions for the guide."""
    head = (
        "Γ",
        "translation",
        "∣Ψ6∣",
        "η6",
        "power over exponential",
        "K/16π",
        "plateau",
        "Lindemann",
        "growth",
        "defects",
    )
    lines = [markdown_table(head, layer_rows(results))]
    result = results.transitions
    lines += [
        "",
        "| | η6 is 1/4 at Γ | K is 16π at Γ | how |",
        "|---|---|---|---|",
        f"| here | {_gamma_cell_text(result.hexatic)} | {_gamma_cell_text(result.crystal)} | simulation, "
        f"{results.layers[0]['grains']} grains, one start from the crystal |",
    ]
    lines += ["", *(f"- {item}" for item in transitions_text(results).splitlines())]
    return "\n".join(lines)


def _gamma_cell_text(item: BootstrapInterval | None) -> str:
    return "not reached" if item is None else _gamma_text(item)
