"""Columns of a record, with the values stored at the end of a tick."""

from __future__ import annotations

import numpy as np

from granular.shared.array_types import Float

COLUMNS = (
    "time",
    "height",
    "velocity",
    "upward",
    "kinetic",
    "pair",
    "piston",
    "work",
    "piston_loss",
    "closest",
    "fastest",
    "stiffest",
    "grains",
    "turned",
)
"""First columns of a record, in natural units:

- time;
- height and velocity of the piston, and the upward force on it;
- kinetic energy of the grains, energy of the pairs, energy of the piston;
- external work, and energy lost by the piston;
- minimum distance of two grains, and maximum speed;
- upper bound of the highest angular frequency that the bed can reach;
- number of grains;
- energy turned over so far (see `granular.engine`).

They are followed by the energy of each effect, the energy lost to each effect, the values that effects
record, and the force on each side of the cell."""

# Kernels take integers, not strings; a test compares the two lists.
(
    TIME,
    HEIGHT,
    VELOCITY,
    UPWARD,
    KINETIC,
    PAIR,
    PISTON,
    WORK,
    PISTON_LOSS,
    CLOSEST,
    FASTEST,
    STIFFEST,
    GRAINS,
    TURNED,
) = range(len(COLUMNS))

ENERGIES = len(COLUMNS)
"""Index of the first column with the energy of an effect."""


def column_names(law_count: int, record_count: int = 0, side_count: int = 0) -> tuple[str, ...]:
    """Return a record's column names for given numbers of effects, recorded values and sides."""
    counts = {"energy": law_count, "loss": law_count, "own": record_count, "side": side_count}
    numbered = (numbered_column_name(kind, k) for kind, count in counts.items() for k in range(count))
    return (*COLUMNS, *numbered)


def numbered_column_name(kind: str, index: int) -> str:
    """Return the name of a column that exists for each effect or side, such as ``energy 0``."""
    return f"{kind} {index}"


def energy_ledger_column_count(law_count: int) -> int:
    """Return the number of columns that are needed for the energy balance."""
    return ENERGIES + 2 * law_count


def total_potential_energies(rows: Float[np.ndarray, "r columns"]) -> Float[np.ndarray, "r"]:
    """Total potential energy of the grains in each record."""
    return np.asarray(_potential_energy_columns(rows).sum(axis=1))


def summed_potential_magnitudes(rows: Float[np.ndarray, "r columns"]) -> Float[np.ndarray, "r"]:
    """Sum of the magnitudes of all potential energies in each record."""
    return np.asarray(np.abs(_potential_energy_columns(rows)).sum(axis=1))


def total_energies(rows: Float[np.ndarray, "r columns"]) -> Float[np.ndarray, "r"]:
    """Energy of grains and piston in each record."""
    terms = [rows[:, [KINETIC]], _potential_energy_columns(rows), rows[:, [PISTON]]]
    return np.asarray(np.concatenate(terms, axis=1).sum(axis=1))


def total_energy(row: Float[np.ndarray, "columns"]) -> float:
    """Energy of grains and piston in one record."""
    return float(total_energies(row[None])[0])


def total_losses(rows: Float[np.ndarray, "r columns"]) -> Float[np.ndarray, "r"]:
    """Return the energy dissipated from the start of the run to each record."""
    return np.asarray(rows[:, _first_loss_column_index(rows) :].sum(axis=1) + rows[:, PISTON_LOSS])


def _first_loss_column_index(rows: np.ndarray) -> int:
    return (ENERGIES + rows.shape[1]) // 2


def _potential_energy_columns(rows: np.ndarray) -> np.ndarray:
    """Return each record's potential energies: the pairs' energy, then the effects' in reverse order."""
    return np.concatenate(
        [rows[:, [PAIR]], rows[:, ENERGIES : _first_loss_column_index(rows)][:, ::-1]], axis=1
    )
