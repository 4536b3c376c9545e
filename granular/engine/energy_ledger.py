"""The energy ledger: kinetic + potential + dissipated - work done from outside stays the same."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from granular.engine import columns

if TYPE_CHECKING:
    from jaxtyping import Float

WRONG = 1e-2
"""Residual over the energy turned over beyond which a run is stopped."""
COARSE_FACTOR = 10.0
"""Factor of the first limit with de Paula's regularised friction, or with de Paula's list of pairs
under friction, since de Paula's beds are run at de Paula's steps; the limit of a doubtful run is wider still
(`granular.scene.dry_friction`).

Of 119 random runs of these kinds, with at most 12 grains, 18 were off by more than 1e-4. Most often
it was the step: a quarter of it left a sixteenth, with any list, skin and threshold speed. Not so
where a list that is made anew takes pairs in and leaves others out, 6e-4 in a run at any step (3e-6
with all pairs), and where regularised friction is far above the other forces and chatters: 0.09
under a normal load of 1 N on a grain, 0.002 at a sixteenth of the step."""
_ROUNDING = 1e-11  # of the energies that are added up; below it a residual says nothing
_LEAST_TURNOVER = 1e-5
"""Least energy turned over that counts, over the potential energy that is there: what has just
begun to move from rest has a large relative error of no consequence."""


@dataclasses.dataclass
class EnergyLedger:
    """Memory of the energy ledger from record to record, in natural units."""

    start: float  # energy at the start [F* D]
    potential: float  # at the start [F* D]
    piston: float  # at the start [F* D]
    wrong: float = WRONG  # relative residual that stops the run
    moved: float = 0.0  # energy turned over so far [F* D]
    worst: float = 0.0  # largest residual so far [F* D]

    @property
    def worst_relative_residual(self) -> float:
        """Greatest residual over the energy turned over."""
        return self.worst / self.moved if self.moved > 0.0 else 0.0

    @classmethod
    def from_first_record(cls, row: Float[np.ndarray, "columns"], *, coarse: bool) -> EnergyLedger:
        """Begin a ledger with this record."""
        rows = row[None]
        return cls(
            start=float(columns.total_energies(rows)[0]),
            potential=float(columns.total_potential_energies(rows)[0]),
            piston=float(row[columns.PISTON]),
            moved=_LEAST_TURNOVER * float(columns.summed_potential_magnitudes(rows)[0]),
            wrong=WRONG * (COARSE_FACTOR if coarse else 1.0),
        )

    def residuals(
        self, rows: Float[np.ndarray, "r columns"]
    ) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"]]:
        """Imbalance of kinetic, potential and lost energy and work in each record [F* D]."""
        potential, total = columns.total_potential_energies(rows), columns.total_energies(rows)
        lost, work = columns.total_losses(rows), rows[:, columns.WORK]
        # The largest sum so far of the kinetic energy, the changes of potential and piston, losses and work.
        moved = np.maximum(rows[:, columns.TURNED], self.moved)
        residual = total - self.start + lost - work
        floor = _ROUNDING * (np.abs(potential) + np.abs(total) + lost + np.abs(work))
        excess = np.maximum(np.abs(residual) - floor, 0.0)
        self.moved = float(moved[-1])
        relative = np.divide(excess, moved, out=np.zeros_like(moved), where=moved > 0.0)
        relative[(moved <= 0.0) & (excess > 0.0)] = np.inf
        relative[~np.isfinite(residual)] = np.inf
        return excess, relative

    def find_unbalanced_record(self, rows: Float[np.ndarray, "r columns"]) -> tuple[int, float] | None:
        """Enter records, and find the first one that cannot be trusted: its index and relative residual."""
        if not len(rows):
            return None
        residual, relative = self.residuals(rows)
        self.worst = max(self.worst, float(residual.max()))
        bad = np.flatnonzero(relative > self.wrong)
        return (int(bad[0]), float(relative[bad[0]])) if len(bad) else None
