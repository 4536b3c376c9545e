"""Comparison of pair sums, on one arrangement and in one run."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from benchmarks import c_kernel
from benchmarks.available_engines import engine
from benchmarks.peers import (
    PlainVerletList,
    jax_forces,
    plain_loop,
    plain_loop_with_load,
    plain_verlet_list,
    verlet_list_workspace,
)
from benchmarks.timing import minimum_seconds
from granular.compiled import entry
from granular.pairs.cut_off_sum import cut_off_sum
from granular.pairs.direct_sum import (
    MIN_GRAINS_FOR_PARTS,
    allocate_partial_sums,
    direct_sum,
    pad_coordinates,
    pad_values,
)
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.near_list import VERLET_RADIUS as SOURCE_RADIUS
from granular.pairs.stripes import Stripes, allocate_stripes

_direct_sum = entry(direct_sum)

DENSITY = 0.307
"""Number of grains per square diameter: packing fraction 0.241, as in de Paula's compressed bed."""

SKIN = 1.0
"""Skin of the plain Verlet list [D]: a tenth of the radius, the usual choice."""

STEP = 2e-3
"""Displacement of a grain between sums [D]: a speed of 0.1 D/tau and steps of 0.02 tau."""

BATCH = 250
"""Number of sums timed together, so that they share the building of lists."""

_LAMMPS_PAIRS = 2e6
"""Approximate number of pairs summed by LAMMPS in one run of five or more steps."""

_JAX_MOST = 3000
"""Number of grains above which the matrix of all pairs exceeds the memory."""


def arrangement(count: int, seed: int = 1) -> np.ndarray:
    """Return positions (n, 2) [D] at the compressed bed's density, near the sites of a square grid."""
    random = np.random.default_rng(seed)
    side, spacing = int(np.ceil(np.sqrt(count))), DENSITY**-0.5
    index = np.stack([np.arange(count) % side, np.arange(count) // side], axis=1)
    return spacing * (index + random.uniform(-0.25, 0.25, (count, 2)))


class TimedSum(NamedTuple):
    """A timed pair sum.

    Attributes
    ----------
    call : callable
    force : callable
        Returns the forces of the last call (n, 2) [F*].
    """

    call: Callable[[], Any]
    force: Callable[[], np.ndarray]


class PaddedGrains:
    """Padded arrays of one arrangement."""

    def __init__(self, positions: np.ndarray) -> None:
        self.count, self.positions = len(positions), positions
        self.x, self.y = pad_coordinates(positions)
        self.weight = pad_values(np.ones(self.count))

    def sums(self) -> np.ndarray:
        """Return the workspace for three sums."""
        return np.zeros((3, self.x.size))

    def timed(self, sums: np.ndarray, call: Callable[[], Any]) -> TimedSum:
        return TimedSum(call, sums[:2, : self.count].T.copy)


def direct(grains: PaddedGrains, *, load: bool = False, threaded: bool = False) -> TimedSum:
    sums, x = grains.sums(), grains.x
    third, weight = (sums[2], grains.weight) if load else (None, None)
    buffers = allocate_partial_sums(x.size)
    thread = True if threaded and buffers is not None else None
    return grains.timed(
        sums,
        lambda: _direct_sum(
            GrainArrays(x, grains.y, sums[0], sums[1], load=third, weight=weight), buffers, thread, None
        ),
    )


def plain(grains: PaddedGrains, *, load: bool = False) -> TimedSum:
    sums, count = grains.sums(), grains.count
    if load:
        return grains.timed(
            sums, lambda: plain_loop_with_load(grains.x, grains.y, *sums, grains.weight, count)
        )
    return grains.timed(sums, lambda: plain_loop(grains.x, grains.y, *sums[:2], count))


def in_c(grains: PaddedGrains) -> TimedSum:
    sums = grains.sums()
    return grains.timed(sums, c_kernel.pair_forces(grains.x, grains.y, sums[0], sums[1]))


def in_jax(grains: PaddedGrains) -> TimedSum:
    call = jax_forces(grains.positions)
    return TimedSum(call, lambda: np.asarray(call()))


@numba.njit(error_model="numpy")
def _move(x: np.ndarray, y: np.ndarray, start: np.ndarray, way: np.ndarray, at: int) -> None:
    """Move grains back and forth on straight lines, so that lists are rebuilt as in a run."""
    turn = 500 - abs(at % 1000 - 500)
    for i in range(start.shape[1]):
        x[i] = start[0, i] + turn * way[0, i]
        y[i] = start[1, i] + turn * way[1, i]


@numba.njit(error_model="numpy")
def _cut_off_steps(
    near: Stripes,
    radius: float,
    x: np.ndarray,
    y: np.ndarray,
    sums: np.ndarray,
    start: np.ndarray,
    way: np.ndarray,
    at: int,
) -> None:
    for step in range(BATCH):
        _move(x, y, start, way, at + step)
        arrays = GrainArrays(x, y, sums[0], sums[1], None, None, None, None, None, None, None)
        cut_off_sum(near, radius, None, None, start.shape[1], arrays)


@numba.njit(error_model="numpy")
def _list_steps(
    known: PlainVerletList,
    radius: float,
    x: np.ndarray,
    y: np.ndarray,
    sums: np.ndarray,
    start: np.ndarray,
    way: np.ndarray,
    at: int,
) -> None:
    for step in range(BATCH):
        _move(x, y, start, way, at + step)
        plain_verlet_list(known, radius, SKIN, x, y, sums[0], sums[1], start.shape[1])


def _displacements(count: int) -> np.ndarray:
    """Return the displacement of each grain between sums (n, 2) [D]."""
    angle = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, count)
    return STEP * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _in_motion(positions: np.ndarray, steps: Any, lists: Any) -> TimedSum:
    grains = PaddedGrains(positions)
    sums, at = grains.sums(), iter(range(0, 10**12, BATCH))
    start = np.stack([grains.x, grains.y])[:, : grains.count].copy()
    way = _displacements(grains.count).T.copy()
    return grains.timed(
        sums, lambda: steps(lists, SOURCE_RADIUS, grains.x, grains.y, sums, start, way, next(at))
    )


def by_cut_off(positions: np.ndarray) -> TimedSum:
    """Make a call of `BATCH` sums of moving grains."""
    size = PaddedGrains(positions).x.size
    return _in_motion(positions, _cut_off_steps, allocate_stripes(size, moments=False, with_loads=False))


def by_plain_list(positions: np.ndarray) -> TimedSum:
    """Make a call of `BATCH` sums of moving grains."""
    return _in_motion(positions, _list_steps, verlet_list_workspace(len(positions), 200))


def exact_forces(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return forces (n, 2) in extended precision, and the sums of their magnitudes (n,) [F*]."""
    index = positions.astype(np.longdouble)
    force, magnitude = np.zeros_like(index), np.zeros(len(index), dtype=np.longdouble)
    for i in range(len(index)):
        delta = index[i] - index
        r2 = (delta**2).sum(axis=1)
        r2[i] = np.inf
        force[i] = (0.75 * r2[:, None] ** -2.5 * delta).sum(axis=0)
        magnitude[i] = (0.75 * r2**-2.0).sum()
    return force, magnitude


def direct_sums(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return time [s] of each sum over all pairs, and maximum error over a grain's sum of |f|."""
    grains = PaddedGrains(arrangement(count))
    entries = {"plain numba loop": plain(grains), "direct sum": direct(grains)}
    if c_kernel.missing() is None:
        entries["C kernel with intrinsics"] = in_c(grains)
    if count <= _JAX_MOST and importlib.util.find_spec("jax") is not None:
        entries["plain JAX"] = in_jax(grains)
    if openmm := engine("openmm"):  # a step, which is little more than the sum
        for item in openmm.PLATFORMS:
            entries[f"OpenMM, {item}"] = TimedSum(*openmm.steps(grains.positions, item))
    entries["plain numba loop, with friction load"] = plain(grains, load=True)
    entries["direct sum, with friction load"] = direct(grains, load=True)
    if count >= MIN_GRAINS_FOR_PARTS and numba.config.NUMBA_NUM_THREADS > 1:
        entries[f"direct sum, {numba.get_num_threads()} threads"] = direct(grains, threaded=True)
    calls = {name: item.call for name, item in entries.items()}
    seconds = minimum_seconds(calls, rounds=rounds, seconds=0.002)
    forces = {name: item.force() for name, item in entries.items()}
    if lammps := engine("lammps"):
        for style in (lammps.TABLE, lammps.EXACT):
            steps = max(5, round(_LAMMPS_PAIRS / count**2))
            seconds[style], forces[style] = lammps.steps(grains.positions, style, count=steps)
    force, magnitude = exact_forces(grains.positions)
    rows = []
    for name, result in forces.items():
        error = np.abs(result - force).max(axis=1) / magnitude
        base = "plain numba loop" + (", with friction load" if "load" in name else "")
        rows.append(
            {
                "sum": name,
                "grains": count,
                "seconds": seconds[name],
                "ns per pair": 2e9 * seconds[name] / (count * (count - 1)),
                "times plain": seconds[base] / seconds[name],
                "over direct": seconds[name] / seconds["direct sum"],
                "error": float(error.max()),
            }
        )
    return rows


def cut_off_sums(count: int, rounds: int) -> list[dict[str, Any]]:
    """Return the time of a sum [s] over pairs within de Paula's radius, with lists rebuilt as grains move."""
    from scipy.spatial import cKDTree

    positions = arrangement(count)
    pairs = len(cKDTree(positions).query_pairs(SOURCE_RADIUS, output_type="ndarray"))
    entries = {"plain Verlet list": by_plain_list(positions), "cut-off": by_cut_off(positions)}
    calls = {name: item.call for name, item in entries.items()}
    result = minimum_seconds(calls, rounds=rounds, seconds=0.0)
    seconds = {name: time / BATCH for name, time in result.items()}
    if lammps := engine("lammps"):
        seconds[lammps.TABLE] = lammps.steps(
            positions,
            lammps.TABLE,
            count=BATCH,
            cut=SOURCE_RADIUS,
            velocities=_displacements(count) / 0.02,
            dt=0.02,
        ).seconds
    return [
        {
            "sum": name,
            "grains": count,
            "seconds": time,
            "ns per pair": 1e9 * time / pairs,
            "times plain": seconds["plain Verlet list"] / time,
        }
        for name, time in seconds.items()
    ]


def exponent(counts: np.ndarray, seconds: np.ndarray) -> tuple[float, float]:
    """Return the exponent of the time's growth with the number of grains, and half its 95 % interval.

    It needs three or more counts; the scatter of their logarithms about the line is assumed normal.
    """
    from scipy.stats import t as student

    line, covariance = np.polyfit(np.log(counts), np.log(seconds), 1, cov="unscaled")
    rest, free = np.log(seconds) - np.polyval(line, np.log(counts)), len(counts) - 2
    error = np.sqrt(covariance[0, 0] * float(rest @ rest) / free)
    return float(line[0]), float(error * student.ppf(0.975, free))
