"""The energy ledger: kinetic + potential + dissipated - work done from outside stays the same."""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.engine.loop import COLUMNS

ENERGIES = ("kinetic", "pair", "wall", "weight", "piston")
WRONG = 1e-2
"""Residual over the energy turned over beyond which a run is stopped."""
DOUBTFUL = 1e-4
"""Residual beyond which a run is called degraded."""
_ROUNDING = 1e-11  # of the energies that are added up; below it a residual says nothing


def _columns(rows: np.ndarray, *names: str) -> np.ndarray:
    return rows[:, [COLUMNS.index(name) for name in names]]


@dataclasses.dataclass
class Ledger:
    """What the ledger must remember from record to record, in natural units.

    Attributes
    ----------
    start : float
        Energy at the start of the run.
    potential : float
        Potential energy at the start.
    moved : float
        Energy turned over so far: the greatest kinetic energy and change of potential energy,
        and what was lost and worked.
    worst : float
        Greatest residual so far.
    """

    start: float
    potential: float
    moved: float = 0.0
    worst: float = 0.0

    @property
    def closure(self) -> float:
        """Greatest residual over the energy turned over."""
        return self.worst / self.moved if self.moved > 0.0 else 0.0

    @classmethod
    def opened(cls, row: np.ndarray) -> Ledger:
        """A ledger from the first record."""
        rows = row[None]
        potential = float(_columns(rows, "pair", "wall", "weight").sum())
        return cls(start=float(_columns(rows, *ENERGIES).sum()), potential=potential)

    def residuals(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual of each record beyond rounding [F* D], and over the energy moved by then."""
        potential = _columns(rows, "pair", "wall", "weight").sum(axis=1)
        total = _columns(rows, *ENERGIES).sum(axis=1)
        lost, work = _columns(rows, "drag_loss", "work").T
        kinetic = _columns(rows, "kinetic")[:, 0]
        moved = kinetic + np.abs(potential - self.potential) + lost + np.abs(work)
        moved = np.maximum.accumulate(np.maximum(moved, self.moved))
        residual = total - self.start + lost - work
        floor = _ROUNDING * (np.abs(potential) + np.abs(total) + lost + np.abs(work))
        excess = np.maximum(np.abs(residual) - floor, 0.0)
        self.moved = float(moved[-1])
        relative = np.divide(excess, moved, out=np.zeros_like(moved), where=moved > 0.0)
        relative[(moved <= 0.0) & (excess > 0.0)] = np.inf
        relative[~np.isfinite(residual)] = np.inf
        return excess, relative

    def check(self, rows: np.ndarray) -> int | None:
        """Enter records; the index of the first one that cannot be trusted, if any."""
        if not len(rows):
            return None
        residual, relative = self.residuals(rows)
        self.worst = max(self.worst, float(residual.max()))
        bad = np.flatnonzero(relative > WRONG)
        return int(bad[0]) if len(bad) else None
