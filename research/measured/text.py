"""Measurements and results in tables."""

from __future__ import annotations

from collections.abc import Mapping

from granular.shared.blocks import Table
from research.campaign import Plain, markdown_of_console_table
from research.measured.measurements import (
    CELLS,
    MEASUREMENTS,
    packing_that_lifts_raised_dipole,
    scene_of_measurement,
)

SAID = {
    "deviation": "largest at 0.5",
    "skewness": "0 at 0.5",
    "pentagons": "at 0.5 as many as hexagons",
    "hexagons": "dominant at 0",
    "heptagons": "at 0.5 as many as hexagons",
    "psi6": "not read",
}
"""Statements of Tsuchikusa et al. on the cells, over the fraction of small magnets."""


def tables_by_block_name(result: Plain) -> Mapping[str, Table]:
    """Return tables by the names of their blocks; tables of results may be missing."""
    packing = packing_that_lifts_raised_dipole(scene_of_measurement("taberlet"), 1e-4)
    lifted = f"{packing:.3f} for discs of 6 x 3 mm, one of them 0.1 mm higher"
    here = {"tsuchikusa": "below", "taberlet": lifted, "reiss": lifted}
    entries = [
        (
            *(entry[key] for key in ("source", "read", "not_read")),
            f"`{name}`: {entry['compare']}",
            here.get(name, "not run"),
        )
        for name, entry in MEASUREMENTS.items()
    ]
    header: tuple[str, ...] = ("measurement", "read", "not read", "scene, and what to compare", "here")
    tables = {"measurements": Table(header, entries)}
    if result:
        mixtures = sorted(result["mixtures"], key=lambda row: row["ratio"])
        header = ("small magnets", "Tsuchikusa et al.", *(f"here, {row['ratio']:g}" for row in mixtures))
        rows = [(name, SAID[name], *(f"{row[name]:.3f}" for row in mixtures)) for name in CELLS]
        tables["mixtures"] = Table(header, rows)
        tables["sizes"] = _table_of_sizes(result["rescaled"])
        names = ("N", "W [m]", "kappa", "rest/W", "rest, divided by the rest of the lattice")
        keys = ("count", "width", "kappa", "rest", "over lattice")
        rows = [tuple(f"{row[key]:.4g}" for key in keys) for row in result["same magnets"]]
        tables["same magnets"] = Table(names, rows)
    return tables


def _table_of_sizes(results: list[Plain]) -> Table:
    """Return, by kappa, figures of the first width and the largest relative difference of other widths."""
    names, rows = ("rest", "frequency", "zeta"), []
    for kappa in sorted({f"{row['kappa']:.4g}" for row in results}, key=float):
        first, *others = [row for row in results if f"{row['kappa']:.4g}" == kappa]
        spread = max(abs(row[name] / first[name] - 1.0) for row in others for name in names)
        rows.append((kappa, *(f"{first[name]:.5f}" for name in names), f"{spread:.0e}"))
    return Table(("kappa", "rest/W", "f √(W/g)", "zeta", "largest difference"), rows)


def tables_text(result: Plain) -> str:
    """Return the tables for the console."""
    return "\n\n".join(str(table) for table in tables_by_block_name(result).values())


def tables_markdown_by_block(result: Plain) -> dict[str, str]:
    """Return the tables for the page by the names of their blocks, with the command that made them."""
    made = f"(`{result['made']['command']}` on {result['made']['date']}, {result['made']['processor']}.)"
    return {
        name: f"{markdown_of_console_table(table)}\n\n{made}"
        for name, table in tables_by_block_name(result).items()
    }
