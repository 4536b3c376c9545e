"""Hysteresis: the energy that a cycle of compression and expansion leaves in the bed."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.forces import piston_force
from granular.observables.frame import check_series, labelled_columns
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray
    from jaxtyping import Float

    from granular.run.trajectory import Trajectory

LEAST_STROKE = 0.01
"""A reversal of the piston by less than this fraction of its whole range makes no cycle."""


class CompressionCycle(NamedTuple):
    """Samples of a cycle: from a highest point down and up to the next one."""

    start: int
    lowest: int
    stop: int


def hysteresis_energy(height: np.ndarray, force: np.ndarray) -> float:
    """Work of the piston on the bed over one cycle, the area of the loop of force over height.

    The loop is that of [D, Fig. 3.4].

    Parameters
    ----------
    height : float (n,)
        Height of the piston over a cycle that begins at its greatest height: down and up again [m]; at
        least three samples.
    force : float (n,)
        Force of the grains on the piston, upwards [N].

    Returns
    -------
    float
        -(integral of F dh) [J], positive where the bed takes up energy, by the trapezoidal rule; NaN where
        a height or force is. Only the part of the loop up to the lower of the first and the last
        height is counted, so that it is closed: a cycle that begins elsewhere than at its top loses what
        lies above.

    Raises
    ------
    InputError
        If there are fewer than three samples, or the shapes differ or are not (n,).

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import hysteresis_energy
    >>> height = np.array([2.0, 1.0, 1.0, 2.0, 2.0])  # down at a force of 3, up at 1
    >>> force = np.array([3.0, 3.0, 1.0, 1.0, 3.0])
    >>> float(hysteresis_energy(height, force))
    2.0
    """
    height, force = check_series("height and force", height, force)
    if len(height) < 3:
        raise InputError(f"a cycle of {len(height)} samples; give at least 3 samples")
    # The loop is closed up to the lower of its two highest points only.
    top = min(height[0], height[-1])
    return -_work_below_height(height, force, top)


def cycle_bounds(height: Float[np.ndarray, "n"]) -> list[CompressionCycle]:
    """Cycles of a motion, from each highest point to the next; height [m]."""
    height = np.asarray(height, dtype=np.float64)
    turns = _turning_points(height, LEAST_STROKE * np.ptp(height) if len(height) else 0.0)
    return [
        CompressionCycle(_last_sample_of_turn(height, a, b), b, c)
        for a, b, c in zip(turns, turns[1:], turns[2:], strict=False)
        if height[b] < height[a]
    ]


def hysteresis_cycles(run: Trajectory) -> xarray.Dataset:
    """Hysteresis of every cycle of compression and expansion of a run [D, Fig. 3.4].

    Energies are those of `hysteresis_energy`. Reversals by less than `LEAST_STROKE` of the piston's whole
    range make no cycle.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.

    Returns
    -------
    xarray.Dataset
        ``energy`` [J], ``start`` and ``stop`` [s], ``lowest`` and ``highest`` [m] (between which the
        loop is closed) on ``cycle``; empty where there is no cycle.

    Raises
    ------
    InputError
        If the scene has no piston, or no force acts on it (``effects.walls.top``).
    """
    import xarray

    force = piston_force(run).values
    height = run.dataset["piston_height"].values
    time = run.dataset["time"].values
    cycles = cycle_bounds(height)
    parts = [slice(cycle.start, cycle.stop + 1) for cycle in cycles]
    columns = {
        "energy": ([hysteresis_energy(height[k], force[k]) for k in parts], "J", "energy lost"),
        "start": ([time[cycle.start] for cycle in cycles], "s", "start of the compression"),
        "stop": ([time[cycle.stop] for cycle in cycles], "s", "end of the expansion"),
        "lowest": ([height[cycle.lowest] for cycle in cycles], "m", "least height"),
        "highest": (
            [min(height[cycle.start], height[cycle.stop]) for cycle in cycles],
            "m",
            "height up to which the loop is counted",
        ),
    }
    return xarray.Dataset(labelled_columns("cycle", columns), coords={"cycle": np.arange(len(cycles))})


def _work_below_height(height: np.ndarray, force: np.ndarray, top: float) -> float:
    """Integral of F dh over the parts of the path at or below the height ``top``."""
    start, step = height[:-1], np.diff(height)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (top - start) / step
    # Each piece of the path counts from share a to share b of its length.
    crossing = np.clip(np.where(step == 0.0, 0.0, fraction), 0.0, 1.0)
    a = np.where(step < 0.0, crossing, 0.0)
    b = np.where(step > 0.0, crossing, 1.0)
    middle = 0.5 * (a + b)
    mean_force = force[:-1] + middle * np.diff(force)
    return float(np.sum(mean_force * (b - a) * step))


def _turning_points(height: np.ndarray, least: float) -> list[int]:
    """Return the samples where the motion turns by more than ``least``, and both ends."""
    turns: list[int] = []
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(height):
        high = k if value > height[high] else high
        low = k if value < height[low] else low
        if rising is not True and value - height[low] > least:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and height[high] - value > least:
            turns.append(high)
            rising, low = False, k
    if rising is not None:
        turns.append(high if rising else low)
    return turns


def _last_sample_of_turn(height: np.ndarray, turn: int, after: int) -> int:
    """Last sample of a rest that begins at a turning point."""
    same = np.flatnonzero(height[turn:after] == height[turn])
    return turn + int(same[-1])
