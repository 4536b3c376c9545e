"""Measurements and results in words and tables."""

from __future__ import annotations

from research.campaign import Plain, markdown_of
from research.measured.measurements import MEASUREMENTS, largest_packing, upright_magnets
from validation.text_tables import TextTable, text_table


def text(result: Plain) -> str:
    """Tables for the console; results may be missing."""
    tables = {"mixtures": _mixtures, "sizes": _sizes, "plain": _same_magnets} if result else {}
    made = [table(result).text() for table in tables.values()]
    return "\n\n".join([_measurements().text(), *made])


def markdown(result: Plain) -> dict[str, str]:
    """Tables by the names of their blocks, with the command that made them."""
    made = f"(`{result['made']['command']}` on {result['made']['date']}, {result['made']['processor']}.)"
    tables = {
        "measurements": _measurements(),
        "mixtures": _mixtures(result),
        "sizes": _sizes(result),
        "same magnets": _same_magnets(result),
    }
    return {name: f"{markdown_of(table)}\n\n{made}" for name, table in tables.items()}


def _measurements() -> TextTable:
    here = {m.source: "not run" for m in MEASUREMENTS} | {MEASUREMENTS[0].source: "below"}
    lifted = largest_packing(upright_magnets(), 1e-4)
    words = f"{lifted:.3f} for a disc of 6 x 3 mm that lies 0.1 mm higher"
    here |= {m.source: words for m in MEASUREMENTS if m.scene is upright_magnets}
    rows = [
        (f"{m.source}, doi:{m.doi}", m.read, m.not_read, f"`{m.scene().name}`: {m.compared}", here[m.source])
        for m in MEASUREMENTS
    ]
    return text_table(("measurement", "read", "not read", "scene, and what to compare", "here"), rows)


def _mixtures(result: Plain) -> TextTable:
    """Published statements and figures of the mixtures, over the ratio of small magnets."""
    rows = result["mixtures"]
    by_ratio = {row["ratio"]: row for row in rows}
    half, equal = by_ratio[0.5], by_ratio[0.0]
    polygons = ("pentagons", "hexagons", "heptagons")
    widest = max(rows, key=lambda row: row["deviation"])
    return text_table(
        ("quantity", "Tsuchikusa et al.", "here"),
        [
            ("ratio of small magnets at the largest deviation", "about 0.5", f"{widest['ratio']:g}"),
            ("skewness at a ratio of 0.5", "0", f"{half['skewness']:.2f}"),
            (
                "pentagons, hexagons, heptagons at 0.5",
                "about as many",
                ", ".join(f"{half[name]:.2f}" for name in polygons),
            ),
            ("hexagons among equal magnets", "dominant", f"{equal['hexagons']:.2f}"),
            *((f"deviation, skewness, psi6 at {row['ratio']:g}", "not read", _three(row)) for row in rows),
        ],
    )


def _three(row: Plain) -> str:
    return ", ".join(f"{row[name]:.3f}" for name in ("deviation", "skewness", "psi6"))


def _sizes(result: Plain) -> TextTable:
    """For each kappa, means over the widths and the largest relative difference."""
    groups: dict[str, list[Plain]] = {}
    for row in result["rescaled"]:
        groups.setdefault(f"{row['kappa']:.4g}", []).append(row)
    names = ("rest", "frequency", "zeta")
    table = []
    for kappa, rows in groups.items():
        spread = max(abs(row[name] / rows[0][name] - 1.0) for row in rows for name in names)
        widths = f"{min(r['width'] for r in rows):.3g} to {max(r['width'] for r in rows):.3g} m"
        table.append((kappa, widths, *(f"{rows[0][name]:.5f}" for name in names), f"{spread:.0e}"))
    return text_table(("kappa", "widths", "rest/W", "f √(W/g)", "zeta", "largest difference"), table)


def _same_magnets(result: Plain) -> TextTable:
    rows = [
        (
            row["count"],
            f"{row['width']:.3f} m",
            f"{row['kappa']:.3g}",
            f"{row['rest']:.4f}",
            f"{row['over lattice']:.4f}",
        )
        for row in result["same magnets"]
    ]
    return text_table(("N", "W", "kappa", "rest/W", "rest over the lattice's"), rows)
