"""The hexatic susceptibility chi6: how far the global bond order fluctuates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.bond_order import global_psi6
from granular.observables.frames import chosen_frames
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def hexatic_susceptibility(orders: np.ndarray, counts: np.ndarray | int) -> float:
    """chi6 = N (<|Psi|^2> - <|Psi|>^2) over frames, of the global order Psi = mean of psi6.

    (Weber, Marx, Binder, Phys. Rev. B 51, 14636, 1995.)

    Parameters
    ----------
    orders : complex (f,)
        `global_psi6` of every frame; NaN is ignored.
    counts : int or int (f,)
        Grains in the mean; N is their mean over the frames.

    Raises
    ------
    InputError
        If the shapes do not fit, or fewer than two frames are left.
    """
    sizes = np.abs(np.asarray(orders, dtype=np.complex128))
    numbers = np.asarray(counts, dtype=np.float64)
    if sizes.ndim != 1 or numbers.shape not in {(), sizes.shape}:
        raise InputError(
            f"orders have the shape {sizes.shape} and counts {numbers.shape}; one each a frame is "
            "wanted"
        )
    known = np.isfinite(sizes)
    if np.count_nonzero(known) < 2:
        raise InputError(f"{np.count_nonzero(known)} frames; a fluctuation needs at least 2")
    number = float(np.broadcast_to(numbers, sizes.shape)[known].mean())
    return number * float(sizes[known].var())


def susceptibility_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """`hexatic_susceptibility` over the frames with start <= time <= stop [s].

    It means something over a time in which the bed is not driven elsewhere, such as a hold.

    Raises
    ------
    InputError
        If fewer than two such frames have interior cells.
    """
    import xarray

    orders, counts = [], []
    for positions in run.dataset["position"].values[chosen_frames(run, start, stop)]:
        cells = voronoi_cells(positions)
        orders.append(global_psi6(positions, cells))
        counts.append(np.count_nonzero(cells.interior))
    return xarray.DataArray(
        hexatic_susceptibility(np.array(orders), np.array(counts)),
        attrs={"units": "1", "long_name": "hexatic susceptibility chi6"},
    )
