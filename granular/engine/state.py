"""Arrays of a run's state, only for the effects that act, and the energy ledger."""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.engine import columns
from granular.kernel_data.state import (
    HEIGHT,
    LOSSES,
    PISTON,
    EffectLaws,
    MeasurementScratchArrays,
    RungeKuttaStageSlopes,
    State,
)
from granular.methods import Method
from granular.pairs.direct_sum import allocate_partial_sums, pad_coordinates
from granular.pairs.far_field import allocate_far_field_state
from granular.pairs.near_law import allocate_near_list_of_law
from granular.pairs.near_list import allocate_verlet_list
from granular.pairs.stripes import allocate_stripes
from granular.shared.array_types import Float


def make_initial_state(
    positions: Float[np.ndarray, "n 2"],
    velocities: Float[np.ndarray, "n 2"],
    height: float,
    acting: EffectLaws,
    method: Method,
) -> State:
    """Make the initial state of a run, with arrays only for the effects that act."""
    count = len(positions)
    x, y = pad_coordinates(positions)
    size, with_loads, cut = x.size, acting.weight is not None, acting.cut
    workspaces = tuple(
        law.workspace(size, count) if hasattr(law, "workspace") else None for law in acting.laws
    )
    hosts = [workspace for law, workspace in zip(acting.laws, workspaces, strict=True) if law is acting.host]
    vx, vy = np.zeros_like(x), np.zeros_like(x)
    vx[:count], vy[:count] = velocities[:, 0], velocities[:, 1]
    stripes, stages = None, None
    if cut is not None:
        shifted = acting.shift is not None
        stripes = allocate_stripes(
            size, moments=cut.moments, with_loads=with_loads, shifted=shifted, periods=cut.periods
        )
    if method.tableau is not None:
        rows = len(method.tableau)
        stages = RungeKuttaStageSlopes(np.zeros((rows, 4, size)), np.zeros((rows, 2)))
    bodies = np.zeros((2 if acting.host is None else len(acting.host.rows.masses), 4))
    bodies[PISTON, HEIGHT] = height
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        bodies=bodies,
        piston=bodies[PISTON],
        ledger=np.zeros(LOSSES + len(acting.laws)),
        clock=np.array([0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0]),
        wall_forces=np.zeros(len(acting.sides)),
        label=np.arange(size),
        load=np.zeros_like(x) if with_loads else None,
        stripes=stripes,
        verlet_list=None if acting.listing is None else allocate_verlet_list(count, acting.listing),
        far_forces=None
        if acting.far is None
        else allocate_far_field_state(acting.far, size, with_loads=with_loads),
        near=None if acting.near is None else allocate_near_list_of_law(acting.near, count),
        workspaces=workspaces,
        host=hosts[0] if hosts else None,
        scratch=np.zeros_like(x),
        buffers=allocate_partial_sums(size) if cut is None and acting.listing is None else None,
        rounding=np.zeros((4, size)) if method.compensated else None,
        slopes=stages,
    )


def allocate_measurement_scratch_arrays(state: State) -> MeasurementScratchArrays:
    """Make the scratch arrays of a measuring pass."""
    return MeasurementScratchArrays(np.zeros_like(state.x), np.zeros(2), np.zeros_like(state.x))


WRONG = 1e-2
"""Maximum residual of the energy balance, relative to the energy turned over; if exceeded, the run stops."""
COARSE_FACTOR = 10.0
"""Factor that raises the limit `WRONG` for regularised friction, or for friction with de Paula's pair list.

These scenes are run with de Paula's time steps. If a user explicitly accepts an inaccurate run, the limit is
wider still (`granular.scene.scene`). Of 119 random runs of these kinds, with at most 12 grains, 18 had a
relative residual above 1e-4. There were three causes:

- usually the time step: a quarter of the step gave a sixteenth of the residual;
- a rebuilt list, which adds and drops pairs: the residual was 6e-4 with any step, but 3e-6 with a sum over
  all pairs;
- regularised friction that far exceeds the other forces and makes velocities oscillate: with a normal load
  of 1 N on a grain the residual was 0.09, and 0.002 with a sixteenth of the step.
"""
_ROUNDING = 1e-11  # of the summed energies; a smaller residual is rounding error
_MINIMUM_TURNOVER = 1e-5
"""Minimum energy turned over, as a fraction of the potential energy, which prevents large relative residuals
just after a start from rest."""


@dataclasses.dataclass
class EnergyLedger:
    """Energy balance of a run up to the latest record, in natural units."""

    start: float  # energy at the start [F* D]
    potential: float  # at the start [F* D]
    piston: float  # at the start [F* D]
    wrong: float = WRONG  # relative residual that stops the run
    moved: float = 0.0  # energy turned over so far [F* D]
    worst: float = 0.0  # largest residual so far [F* D]

    @property
    def worst_relative_residual(self) -> float:
        """Ratio of the maximum residual to the energy turned over."""
        return self.worst / self.moved if self.moved > 0.0 else 0.0

    @classmethod
    def from_first_record(cls, row: Float[np.ndarray, "columns"], *, coarse: bool) -> EnergyLedger:
        """Start an energy balance with the first record of a run."""
        rows = row[None]
        return cls(
            start=float(columns.total_energies(rows)[0]),
            potential=float(columns.total_potential_energies(rows)[0]),
            piston=float(row[columns.PISTON]),
            moved=_MINIMUM_TURNOVER * float(columns.summed_potential_magnitudes(rows)[0]),
            wrong=WRONG * (COARSE_FACTOR if coarse else 1.0),
        )

    def absolute_and_relative_residuals(
        self, rows: Float[np.ndarray, "r columns"]
    ) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"]]:
        """Return each record's energy error beyond rounding, and its ratio to the energy turned over."""
        potential, total = columns.total_potential_energies(rows), columns.total_energies(rows)
        lost, work = columns.total_losses(rows), rows[:, columns.WORK]
        # Maximum so far of kinetic energy + changes of potential and piston energy + losses + work.
        moved = np.maximum(rows[:, columns.TURNED], self.moved)
        residual = total - self.start + lost - work
        floor = _ROUNDING * (np.abs(potential) + np.abs(total) + lost + np.abs(work))
        excess = np.maximum(np.abs(residual) - floor, 0.0)
        self.moved = float(moved[-1])
        relative = np.divide(excess, moved, out=np.zeros_like(moved), where=moved > 0.0)
        relative[(moved <= 0.0) & (excess > 0.0)] = np.inf
        relative[~np.isfinite(residual)] = np.inf
        return excess, relative

    def enter_records_and_find_unbalanced(
        self, rows: Float[np.ndarray, "r columns"]
    ) -> tuple[int, float] | None:
        """Add records; return index and relative residual of the first record above the limit, or None."""
        if not len(rows):
            return None
        residual, relative = self.absolute_and_relative_residuals(rows)
        self.worst = max(self.worst, float(residual.max()))
        bad = np.flatnonzero(relative > self.wrong)
        return (int(bad[0]), float(relative[bad[0]])) if len(bad) else None
