"""The root that a method of integration has at a time step, in place of the exact one.

Some steps of the compiled loop are a map of coordinates and velocities; about the equilibrium it multiplies
the motion of a root by exp(s T). Its own multiplier follows from the exact motion w = (u, s u) and the left
eigenvector y = (s M u + C u, M u) as (y^T map w)/(y^T w): the error is the square of that of w.
"""

from __future__ import annotations

import cmath
import functools
from typing import TYPE_CHECKING

import numpy as np

from granular.kernel_data.state import HEIGHT, SPEED
from granular.linear.bed_forces import BedForces, difference
from granular.linear.equilibrium import Equilibrium
from granular.linear.pencil import of_parts
from granular.linear.roots import Root
from granular.methods.method import Method
from granular.run.engines import NO_TICKS, UNDIVIDED, UNWATCHED
from granular.run.plan import plan
from granular.run.run_state import ARRANGE, RunState
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float


def root_of_steps(
    rest: Equilibrium, root: Root, dt: float, method: str | Method = "stormer-verlet"
) -> complex:
    """Find the root that a method's motion has in place of an exact one.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed that no machine carries.
    root : Root
        Exact root.
    dt : float
        Time step [s], above 0.
    method : str or Method
        Method of integration, as `granular.simulate` takes it.

    Returns
    -------
    complex
        Root of the motion at that step [1/s].

    Raises
    ------
    InputError
        If a machine carries the bed, the method's step has no fixed length, or it takes no drag.
    """
    bed = rest.pencil.bed
    if bed.machine is not None or bed.bath_rate:
        raise InputError(
            "the step of a machine or a bath is no map of the bed alone; compare two runs instead"
        )
    chosen = plan(bed.scene, dt, method, threads=1)
    if chosen.method.variable:
        raise InputError(f"{chosen.method.name!r} varies its step; give a method of equal steps")
    if chosen.method.tableau is not None and rest.pencil.damping.max() > 0.0:
        raise InputError(f"{chosen.method.name!r} takes no drag; give 'stormer-verlet', or a bed without it")
    far = chosen.system.constants.acting.far
    steps = (far.every or 1) if far is not None else 1
    advance = functools.partial(_advance, RunState(chosen), bed, dt, steps)
    motion = np.concatenate([root.shape, root.s * root.shape * bed.scales.time])
    start = np.concatenate([rest.pencil.at, np.zeros(bed.size)])
    displacement = bed.displacement_at(rest.pencil.at) * bed.length
    mapped = of_parts(lambda w: difference(advance, start, w, displacement), motion)
    left = np.concatenate(
        [
            root.s * (rest.pencil.mass @ root.shape) + rest.pencil.damping_times(root.shape),
            (rest.pencil.mass @ root.shape) / bed.scales.time,
        ]
    )
    multiplier = complex((left @ mapped) / (left @ motion))
    return cmath.log(multiplier) / (steps * dt)


def _advance(
    run: RunState, bed: BedForces, dt: float, steps: int, start: Float[np.ndarray, "2q"]
) -> Float[np.ndarray, "2q"]:
    """Coordinates, and velocities times the natural unit of time, after some steps [m]."""
    state, n, length = run.state, bed.grains, bed.length
    q, v = start[: bed.size] / length, start[bed.size :] / length
    state.x[:n], state.y[:n], state.vx[:n], state.vy[:n] = q[:n], q[n : 2 * n], v[:n], v[n : 2 * n]
    if bed.piston is not None:
        state.piston[:] = 0.0
        state.piston[HEIGHT], state.piston[SPEED] = q[bed.piston], v[bed.piston]
    run.motion = run.motion._replace(free=bed.piston is not None)
    run.present_record(ARRANGE)
    h = dt / bed.scales.time
    schedule = UNDIVIDED._replace(length=steps * h, h=h, steps=steps)
    run.call_engine(NO_TICKS._replace(ticks=1), schedule, UNWATCHED)
    piston = () if bed.piston is None else state.piston
    height, speed = piston[HEIGHT : HEIGHT + 1], piston[SPEED : SPEED + 1]
    return length * np.concatenate([state.x[:n], state.y[:n], height, state.vx[:n], state.vy[:n], speed])
