"""How long a machine swings after an impulse."""

from __future__ import annotations

import numpy as np

from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.messages import quoted


def come_down_time(run: Trajectory, share: float = 0.1) -> float:
    """Time from the end of the impulse until the last body stays within a share of its peak [s].

    The displacement is counted from its rest, and the peak is the greatest one behind the impulse.
    A body of its own with the decay rate delta comes down to a tenth within ln(10)/delta.

    Parameters
    ----------
    run : Trajectory
        Whose host is shaken by an impulse.
    share : float
        Above 0, below 1.

    Raises
    ------
    InputError
        If the host has no body or feels no impulse, the share is none, or the body still swings
        wider at the end of the run.

    Examples
    --------
    >>> from granular import Scene, simulate
    >>> scene = Scene.from_plain({
    ...     "name": "bell", "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
    ...     "cell": {"width": "60 D"},
    ...     "piston": {"height": "20 D"},
    ...     "effects": {"host": {
    ...         "bodies": [{"mass": "2 kg", "stiffness": "800 N/m", "damping": "8 kg/s"}],
    ...         "excitation": {"kind": "impulse", "force": "5 N", "duration": "10 ms"}}},
    ...     "protocol": [{"name": "ring", "kind": "hold", "duration": "3 s"}],
    ... })
    >>> run = simulate(scene, progress=False)
    >>> from granular.response import come_down_time
    >>> 1.0 < come_down_time(run) < 1.3  # ln(10)/(2/s) = 1.15 s
    True
    """
    host = run.scene.effects.host
    if host is None or not host.bodies or host.excitation is None:
        raise InputError(f"the scene {quoted(run.scene.name)} has no host that something shakes")
    if host.excitation.kind != "impulse":
        raise InputError(
            f"the host is shaken by {quoted(host.excitation.kind)}; give an impulse, behind which "
            "it swings freely"
        )
    ends = host.excitation.start + (host.excitation.duration or 0.0)
    return come_down_of(run.dataset.time.values, run.dataset.host_displacement.values, ends, share)


def come_down_of(time: np.ndarray, displacement: np.ndarray, ends: float, share: float) -> float:
    """As `come_down_time`, of times [s] and displacements [m] (n,)."""
    check_share(share)
    behind = time >= ends
    if not behind.any():
        raise InputError(f"the run ends at {time[-1]:g} s, before the impulse does, {ends:g} s")
    sizes = np.abs(displacement[behind])
    wide = np.flatnonzero(sizes > share * sizes.max())
    last = int(wide[-1]) if len(wide) else 0
    if last >= len(sizes) - 1 or sizes.max() == 0.0:
        raise InputError(
            f"at the end of the run, {time[-1]:g} s, the body still swings wider than {share:g} of "
            "its peak; run longer, or take a greater share"
        )
    return float(time[behind][last + 1] - ends)


def check_share(share: float) -> None:
    """Refuse a share of the peak that is none."""
    if not 0.0 < share < 1.0:
        raise InputError(f"share = {share:g} must be above 0 and below 1; give 0.1 for a tenth")
