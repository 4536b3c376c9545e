"""How bond orientation relaxes in time: g6(t)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.bond_order import local_psi6
from granular.observables.lags import checked_frames, checked_lags, over_lags_of_run
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def bond_relaxation(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """g6(t) = Re <psi6*(0) psi6(t)> of one grain, over grains and frames (k,).

    It is constant in a crystal, falls algebraically in the hexatic phase and exponentially in a
    liquid (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000). Grains count that have an interior
    cell in both frames.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames; about 30 at even ratios if not given.

    Raises
    ------
    InputError
        If a shape or lag does not fit, or no grain has an interior cell in two such frames.
    """
    frames = checked_frames(frames)
    lags = checked_lags(lags, len(frames))
    orders = np.full(frames.shape[:2], complex(np.nan, np.nan))
    for k, one in enumerate(frames):
        cells = voronoi_cells(one)
        orders[k, cells.interior] = local_psi6(one, cells)[cells.interior]
    found = []
    for lag in lags:
        products = (orders[:-lag].conj() * orders[lag:]).real
        products = products[np.isfinite(products)]
        if not len(products):
            raise InputError(f"no grain has interior cells {lag} frames apart; take shorter lags")
        found.append(products.mean())
    return np.array(found)


def bond_relaxation_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """`bond_relaxation` over the frames with start <= time <= stop [s], on ``lag`` [s].

    Raises
    ------
    InputError
        As `bond_relaxation`, and if the frames are not evenly spaced in time.
    """

    def measure(frames: np.ndarray, lags: np.ndarray) -> np.ndarray:
        return bond_relaxation(run.scene.cell.inside(frames), lags)

    return over_lags_of_run(run, measure, start, stop, "1", "relaxation of bond orientation g6(t)")
