"""The layers as tables: for the console, and for the guide."""

from __future__ import annotations

import math
from typing import Any

from research.campaign import markdown_table
from research.melting.results import Results
from research.melting.transitions import Interval

_HEAD = (
    "Gamma", "translation", "psi6", "eta6", "power/exp.", "K/16pi", "plateau", "Lindemann",
    "growth", "defects",
)  # fmt: skip


def summary(results: Results) -> dict[str, Any]:
    """Plain data: what is made of each layer, and the transitions."""
    return {
        "made": dict(results.made),
        "layers": [
            {name: _plain(value) for name, value in one._asdict().items()} for one in results.orders
        ],
        "transitions": {
            name: _plain(value) for name, value in results.transitions._asdict().items()
        },
    }


def _plain(value: Any) -> Any:
    return value._asdict() if isinstance(value, Interval) else value


def rows_of(results: Results) -> list[tuple[str, ...]]:
    """A row of words for each layer."""
    return [
        (
            f"{one.gamma:g}", f"{one.translation:.2f}", f"{one.order:.3f}",
            _words(one.exponent, 1.0, 3), f"{one.algebraic:.2f}",
            _words(one.modulus, 1.0 / (16.0 * math.pi), 2),
            "" if math.isnan(one.plateau) else f"{one.plateau:.4f}",
            f"{one.lindemann:.3g}", f"{one.growth:.2f}", f"{100.0 * one.defects:.1f} %",
        )
        for one in results.orders
    ]  # fmt: skip


def _words(one: Interval, scale: float, digits: int) -> str:
    if not math.isfinite(one.value):
        return "lost"
    if one.value == 0.0:
        return "0"
    value, low, high = (f"{scale * number:.{digits}f}" for number in one)
    return f"{value} ({low} to {high})"


def sentences(results: Results) -> str:
    """Where the transitions are, in words."""
    found = results.transitions
    return "\n".join(
        f"{what}: {'not reached' if one is None else _gamma(one)}"
        for what, one in (
            ("eta6 is 1/4 at Gamma", found.hexatic),
            ("K is 16 pi at Gamma", found.crystal),
            ("the plateau of the Lindemann parameter is 0.033 at Gamma", found.lindemann),
            ("there is a crystal down to Gamma", found.kept),
            ("there is none up to Gamma", found.lost),
        )
    )


def _gamma(one: Interval | float) -> str:
    if isinstance(one, float):
        return f"{one:.1f}"
    return f"{one.value:.1f} ({one.low:.1f} to {one.high:.1f})"


def text(results: Results) -> str:
    """A table for the console."""
    from validation.table import text_table

    if not results.layers:
        return "no results are committed; run it with --quick or --full"
    grains = results.layers[0]["grains"]
    return f"{text_table(_HEAD, rows_of(results)).text()}\n{grains} grains\n{sentences(results)}"


def markdown(results: Results) -> str:
    """The table and the transitions, for the guide."""
    head = (
        "Γ", "translation", "∣Ψ6∣", "η6", "power over exponential", "K/16π", "plateau", "Lindemann",
        "growth", "defects",
    )  # fmt: skip
    lines = [markdown_table(head, rows_of(results))]
    found = results.transitions
    lines += [
        "", "| | η6 is 1/4 at Γ | K is 16π at Γ | how |", "|---|---|---|---|",
        f"| here | {_cell(found.hexatic)} | {_cell(found.crystal)} | simulation, "
        f"{results.layers[0]['grains']} grains, one start from the crystal |",
    ]  # fmt: skip
    lines += ["", *(f"- {one}" for one in sentences(results).splitlines())]
    return "\n".join(lines)


def _cell(one: Interval | None) -> str:
    return "not reached" if one is None else _gamma(one)
