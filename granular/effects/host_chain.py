"""The chain of bodies that carries a cell: its forces, and what a kick changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import compiled
from granular.engine.state import State

CELL, PISTON_MOUNT, FIXED = range(3)
"""What the chain's last body carries: the cell; the piston; nothing, for the cell is the base."""

PUSH, PULL = range(2)
"""Entries of what holds for the present kick: the frame's acceleration A [D/tau^2], and the force
of the chain on the piston [F*]."""


class Chain(NamedTuple):
    """The bodies, from the base upwards.

    Attributes
    ----------
    masses, stiffness, damping : float64 (n,)
    share : float64 (n,)
        Of the outer force, which acts on a body.
    """

    masses: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    share: np.ndarray


class HostRoom(NamedTuple):
    """The motion of the host, and scratch.

    Attributes
    ----------
    kept : float64 (2, n)
        Displacements over the base, and velocities; of the frame as the last, which is not that of
        the body where this carries the piston.
    present : float64 (2,)
        See `PUSH`.
    forces, changes, diagonal : float64 (n,)
    speeds : float64 (2, m)
        Of the grains, before a kick.
    push : float64 (m,)
        Vertical forces on the grains, without inertia.
    ledger : float64 (k,)
    """

    kept: np.ndarray
    present: np.ndarray
    forces: np.ndarray
    changes: np.ndarray
    diagonal: np.ndarray
    speeds: np.ndarray
    push: np.ndarray
    ledger: np.ndarray


@compiled
def chain_forces(chain: Chain, room: HostRoom, force: float) -> float:
    """Fill in the force of springs and from outside on each body; that on the last one."""
    count = chain.masses.size
    tension, found = 0.0, 0.0
    for back in range(count):
        k = count - 1 - back
        below = room.kept[0, k - 1] if k > 0 else 0.0
        own = chain.stiffness[k] * (room.kept[0, k] - below)
        room.forces[k] = tension - own + chain.share[k] * force
        tension = own
    if count > 0:
        found = room.forces[count - 1]
    return found


@compiled
def kick_bodies(
    chain: Chain, room: HostRoom, span: float, base: float, change: float, dashpots: bool
) -> float:
    """Fill in what the bodies below the last one gain, where that gains ``change``; its dashpot's
    force, at mean velocities. By elimination from the base upwards.
    """
    last, half = chain.masses.size - 1, 0.5 * span
    for k in range(last):
        own, above = chain.damping[k], chain.damping[k + 1]
        if not dashpots:
            own, above = 0.0, 0.0
        speed, below = room.kept[1, k], room.kept[1, k - 1] if k > 0 else 0.0
        drag = above * (room.kept[1, k + 1] - speed) - own * (speed - below)
        gain = span * (room.forces[k] - chain.masses[k] * base + drag)
        if k == last - 1:
            gain += half * above * change
        room.diagonal[k] = chain.masses[k] + half * (own + above)
        if k > 0:
            ratio = half * own / room.diagonal[k - 1]
            room.diagonal[k] -= ratio * half * own
            gain += ratio * room.changes[k - 1]
        room.changes[k] = gain
    for back in range(last):
        k = last - 1 - back
        if k < last - 1 and dashpots:
            room.changes[k] += half * chain.damping[k + 1] * room.changes[k + 1]
        room.changes[k] /= room.diagonal[k]
    if last < 0 or not dashpots:
        return 0.0
    room.changes[last] = change
    below = room.kept[1, last - 1] + 0.5 * room.changes[last - 1] if last > 0 else 0.0
    return -chain.damping[last] * (room.kept[1, last] + 0.5 * change - below)


@compiled
def enter_dashpots(chain: Chain, room: HostRoom, entry: int, span: float, state: State) -> None:
    """Enter what the dashpots take at the mean velocities of a kick."""
    below = 0.0
    for k in range(chain.masses.size):
        mean = room.kept[1, k] + 0.5 * room.changes[k]
        state.ledger[entry] += span * chain.damping[k] * (mean - below) * (mean - below)
        below = mean
