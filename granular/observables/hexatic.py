"""The hexatic susceptibility chi6: how far the global bond order fluctuates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.observables.bond_order import global_psi6, local_psi6
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


def block_susceptibilities(frames: np.ndarray, blocks: Sequence[int] = (1, 2, 4, 8)) -> np.ndarray:
    """chi6 of the bed cut into 1, 2 x 2, 4 x 4 ... blocks of equal sides, float (k,).

    Each block's order is the mean of psi6 over its grains with an interior cell, and its
    fluctuation that over the frames; the mean over the blocks is given. How it goes on to larger
    blocks tells a susceptibility that diverges from one that does not (Weber, Marx, Binder, Phys.
    Rev. B 51, 14636, 1995). NaN where no block has two frames with grains.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.
    blocks : sequence of int
        Blocks along each side.

    Raises
    ------
    InputError
        If the shape is another one, or a number of blocks is below 1.
    """
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; (f, n, 2) is wanted")
    if not blocks or min(blocks) < 1:
        raise InputError(f"blocks {tuple(blocks)}; give whole numbers from 1 up")
    low, high = np.nanmin(array, axis=(0, 1)), np.nanmax(array, axis=(0, 1))
    sums = {number: np.zeros((len(array), number**2), dtype=complex) for number in blocks}
    counts = {number: np.zeros((len(array), number**2)) for number in blocks}
    for k, one in enumerate(array):
        cells = voronoi_cells(one)
        order = local_psi6(one, cells)[cells.interior]
        along = (one[cells.interior] - low) / (high - low)
        for number in blocks:
            column, row = np.minimum((number * along).astype(int), number - 1).T
            np.add.at(sums[number][k], number * row + column, order)
            np.add.at(counts[number][k], number * row + column, 1.0)
    return np.array([_block_mean(sums[number], counts[number]) for number in blocks])


def _block_mean(sums: np.ndarray, counts: np.ndarray) -> float:
    found = []
    for total, number in zip(sums.T, counts.T, strict=True):
        filled = number > 0
        if np.count_nonzero(filled) > 1:
            found.append(hexatic_susceptibility(total[filled] / number[filled], number[filled]))
    return float(np.mean(found)) if found else np.nan


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
    inside = run.scene.cell.inside(run.dataset["position"].values)
    for positions in inside[chosen_frames(run, start, stop)]:
        cells = voronoi_cells(positions)
        orders.append(global_psi6(positions, cells))
        counts.append(np.count_nonzero(cells.interior))
    return xarray.DataArray(
        hexatic_susceptibility(np.array(orders), np.array(counts)),
        attrs={"units": "1", "long_name": "hexatic susceptibility chi6"},
    )
