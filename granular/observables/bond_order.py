"""Bond-orientational order: Psi6 of each grain and of the bed, and its susceptibility."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import checked_positions, chosen_frames, frame_array, over_frames
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def local_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> np.ndarray:
    """The complex bond order of each grain, mean over its Voronoi neighbours of exp(6 i theta).

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    cells : VoronoiCells, optional
        Of the same positions, where they are there already.

    Returns
    -------
    complex (n,)
        NaN for absent grains and for grains without neighbours. Grains at the rim have a value too;
        see ``cells.interior``.

    Raises
    ------
    InputError
        If the positions have another shape.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import local_psi6
    >>> float(np.nanmax(np.abs(local_psi6(places))).round(3))
    1.0
    """
    positions = checked_positions(positions)
    cells = voronoi_cells(positions) if cells is None else cells
    i, j = cells.neighbours.T
    arm = positions[j] - positions[i]
    bond = arm[:, 0] + 1j * arm[:, 1]
    # exp(6 i theta) is the same from both ends of a bond.
    turn = (bond / np.abs(bond)) ** 6
    total = _sum_at(i, turn, len(positions)) + _sum_at(j, turn, len(positions))
    known = cells.sides > 0
    local = np.full(len(positions), complex(np.nan, np.nan))
    local[known] = total[known] / cells.sides[known]
    return local


def psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> float:
    """Psi6 = mean of |local Psi6| over the grains with an interior cell [D, eq. 4.28].

    1 for a perfect hexagonal arrangement, whatever its orientations. NaN without interior cells.
    The arguments are those of `local_psi6`.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import psi6
    >>> round(psi6(places), 3)
    1.0
    """
    cells = voronoi_cells(positions) if cells is None else cells
    sizes = np.abs(local_psi6(positions, cells)[cells.interior])
    return float(sizes.mean()) if len(sizes) else np.nan


def global_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> complex:
    """Mean of the complex local Psi6 over the grains with an interior cell.

    Its size is 1 only where all hexagons have the same orientation. NaN without interior cells. The
    arguments are those of `local_psi6`.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import global_psi6
    >>> round(abs(global_psi6(places)), 3)
    1.0
    """
    cells = voronoi_cells(positions) if cells is None else cells
    values = local_psi6(positions, cells)[cells.interior]
    return complex(values.mean()) if len(values) else complex(np.nan, np.nan)


def psi6_series(run: Trajectory) -> xarray.DataArray:
    """`psi6` of every frame, on ``frame``."""
    return frame_array(run, over_frames(run, psi6), "1", "bond-orientational order Psi6")


def _sum_at(places: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(
        np.bincount(places, values.real, minlength=count)
        + 1j * np.bincount(places, values.imag, minlength=count)
    )


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
